//! Converts a file of events: `cargo run --release -p evis-format --example convert -- IN OUT [FORMAT]`.

use std::path::Path;

use evis_format::{
    ConvertOptions, EventReader, Format, ReadOptions, WriteOptions, convert, create, measure, open,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, input, output, rest @ ..] = args.as_slice() else {
        return Err("usage: convert IN OUT [FORMAT]".into());
    };
    let named =
        rest.first().map(|name| Format::of_name(name).ok_or(format!("no format {name}"))).transpose()?;
    let format = named.or_else(|| Format::of_ending(Path::new(output))).ok_or("name the format")?;
    let mut reader = open(Path::new(input), &ReadOptions::default())?;
    let size = match reader.info().size {
        Some(size) => size,
        None => measure(&mut *reader)?.reach,
    };
    let reader = open(Path::new(input), &ReadOptions::default())?;
    let writer = create(Path::new(output), format, &WriteOptions { size, overwrite: true })?;
    let converted = convert(reader, writer, size, &ConvertOptions::default(), |_| true)?;
    println!("{} events, {}x{}", converted.events, size.0, size.1);
    Ok(())
}
