#![no_main]

evis_fuzz::fuzz!("hdf5");
