//! The default event file: DSEC columns in a group per camera.
