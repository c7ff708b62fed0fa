//! File formats. HDF5 is the default one.

pub mod hdf5;
