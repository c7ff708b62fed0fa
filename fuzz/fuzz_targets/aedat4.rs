#![no_main]

evis_fuzz::fuzz!("aedat4");
