#![no_main]

evis_fuzz::fuzz!("bag");
