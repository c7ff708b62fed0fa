//! Writing: one trait.

use evis_core::Event;
use evis_core::format::FormatError;

use crate::packet::Packet;

/// Writes a file packet by packet, in constant memory. The file has its name once it is finished; a writer
/// that is dropped before leaves nothing.
pub trait EventWriter: Send {
    /// Appends a packet.
    ///
    /// # Errors
    /// What the format cannot hold, events that go back in time or lie outside of the image (then nothing
    /// of the packet is written), and a disk that refuses.
    fn write(&mut self, packet: &Packet) -> Result<(), FormatError>;

    /// Appends events alone; as [`EventWriter::write`].
    ///
    /// # Errors
    /// As [`EventWriter::write`].
    fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError>;

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    /// A disk that refuses.
    fn finish(self: Box<Self>) -> Result<(), FormatError>;
}

/// How a file is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WriteOptions {
    /// Pixels per row, and rows.
    pub size: (u32, u32),
    /// Replace a file that exists.
    pub overwrite: bool,
}
