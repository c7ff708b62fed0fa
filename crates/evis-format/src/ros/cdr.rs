//! OMG's CDR, little-endian, as ROS 2 writes it.

/// A message that is written field by field. Numbers are aligned to their size, from after the four bytes of the
/// encoding.
pub(super) struct Cdr {
    bytes: Vec<u8>,
}

/// Bytes of the encoding: little-endian CDR, no options.
const ENCODING: [u8; 4] = [0, 1, 0, 0];

impl Cdr {
    /// A message of about `size` bytes.
    pub fn of_size(size: usize) -> Self {
        let mut bytes = Vec::with_capacity(size + 128);
        bytes.extend(ENCODING);
        Self { bytes }
    }

    /// A message that starts with a `std_msgs/Header`: a time from 0 on, microseconds, and a frame.
    pub fn stamped(t_us: i64, frame: &str, size: usize) -> Self {
        let mut message = Self::of_size(size);
        message.number(((t_us / 1_000_000) as i32).to_le_bytes());
        message.u32((t_us % 1_000_000) as u32 * 1000);
        message.text(frame);
        message
    }

    /// A number of `N` bytes.
    pub fn number<const N: usize>(&mut self, bytes: [u8; N]) {
        let end = ENCODING.len() + (self.bytes.len() - ENCODING.len()).next_multiple_of(N);
        self.bytes.resize(end, 0);
        self.bytes.extend(bytes);
    }

    pub fn u32(&mut self, number: u32) {
        self.number(number.to_le_bytes());
    }

    pub fn u64(&mut self, number: u64) {
        self.number(number.to_le_bytes());
    }

    /// Numbers in a row, without their count.
    pub fn f64s(&mut self, numbers: &[f64]) {
        for number in numbers {
            self.number(number.to_le_bytes());
        }
    }

    pub fn bool(&mut self, value: bool) {
        self.bytes.push(value.into());
    }

    pub fn text(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.bytes.extend(text.as_bytes());
        self.bytes.push(0);
    }

    /// A sequence of bytes.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.u32(bytes.len() as u32);
        self.bytes.extend_from_slice(bytes);
    }

    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_aligned_from_after_the_encoding() {
        let mut message = Cdr::stamped(2_000_003, "ab", 0);
        message.f64s(&[1.0]);
        message.bool(true);
        message.u32(7);
        let mut want = vec![0, 1, 0, 0, 2, 0, 0, 0, 0xB8, 0x0B, 0, 0, 3, 0, 0, 0, b'a', b'b', 0];
        // 15 bytes after the encoding: one more before a number of eight bytes.
        want.push(0);
        want.extend(1.0_f64.to_le_bytes());
        want.extend([1, 0, 0, 0, 7, 0, 0, 0]);
        assert_eq!(message.finish(), want);
    }
}
