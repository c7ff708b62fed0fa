#![no_main]

evis_fuzz::fuzz!("toml_scene");
