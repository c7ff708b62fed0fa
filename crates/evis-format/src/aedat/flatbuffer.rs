//! As much of `FlatBuffers` as AEDAT 4.0 needs: tables that are read with every offset checked, and tables
//! that are written field by field.
//!
//! Layout: the `FlatBuffers` internals document. A buffer starts with the offset of its root table and a
//! four-letter identifier. A table starts with the signed distance back to its vtable; a vtable holds the
//! sizes of itself and of the table, then each field's offset within the table, 0 where it is absent.

use crate::files::{u16_at, u32_at};

/// A table within a buffer.
#[derive(Clone, Copy)]
pub(super) struct Table<'a> {
    bytes: &'a [u8],
    at: usize,
    vtable: usize,
    fields: usize,
}

/// `bytes` without the length in front, where it is whole.
pub(super) fn sized(bytes: &[u8]) -> Option<&[u8]> {
    let length = u32_at(bytes, 0)? as usize;
    bytes.get(4..)?.get(..length)
}

impl<'a> Table<'a> {
    /// The root of a buffer with this identifier.
    pub fn root(bytes: &'a [u8], identifier: &[u8; 4]) -> Option<Self> {
        if bytes.get(4..8)? != identifier {
            return None;
        }
        Self::at(bytes, u32_at(bytes, 0)? as usize)
    }

    fn at(bytes: &'a [u8], at: usize) -> Option<Self> {
        let back = u32_at(bytes, at)? as i32;
        let vtable = usize::try_from(i64::try_from(at).ok()? - i64::from(back)).ok()?;
        let size = usize::from(u16_at(bytes, vtable)?);
        Some(Self { bytes, at, vtable, fields: size.checked_sub(4)? / 2 })
    }

    /// Where field `index` lies; `None` where it is absent.
    fn place(&self, index: usize) -> Option<usize> {
        if index >= self.fields {
            return None;
        }
        let offset = u16_at(self.bytes, self.vtable + 4 + 2 * index)?;
        (offset != 0).then(|| self.at + usize::from(offset))
    }

    fn bytes_of<const N: usize>(&self, index: usize) -> Option<[u8; N]> {
        self.bytes.get(self.place(index)?..)?.first_chunk().copied()
    }

    pub fn i64(&self, index: usize) -> Option<i64> {
        self.bytes_of(index).map(i64::from_le_bytes)
    }

    pub fn i32(&self, index: usize) -> Option<i32> {
        self.bytes_of(index).map(i32::from_le_bytes)
    }

    pub fn i16(&self, index: usize) -> Option<i16> {
        self.bytes_of(index).map(i16::from_le_bytes)
    }

    pub fn u8(&self, index: usize) -> Option<u8> {
        self.bytes_of::<1>(index).map(|[byte]| byte)
    }

    pub fn f32(&self, index: usize) -> Option<f32> {
        self.bytes_of(index).map(f32::from_le_bytes)
    }

    /// Start and number of elements of a vector of elements of `size` bytes, all of which are there.
    fn vector(&self, index: usize, size: usize) -> Option<(usize, usize)> {
        let at = self.place(index)?;
        let start = at.checked_add(u32_at(self.bytes, at)? as usize)?;
        let count = u32_at(self.bytes, start)? as usize;
        let first = start + 4;
        let end = first.checked_add(count.checked_mul(size)?)?;
        (end <= self.bytes.len()).then_some((first, count))
    }

    /// The bytes of a vector of structures or numbers of `size` bytes; empty where it is absent.
    pub fn elements(&self, index: usize, size: usize) -> Option<&'a [u8]> {
        if self.place(index).is_none() {
            return Some(&[]);
        }
        let (first, count) = self.vector(index, size)?;
        self.bytes.get(first..first + count * size)
    }

    /// The tables of a vector; an element is `None` where its offset leads nowhere.
    pub fn tables(&self, index: usize) -> Option<impl Iterator<Item = Option<Table<'a>>> + use<'a>> {
        let (first, count) = if self.place(index).is_none() { (0, 0) } else { self.vector(index, 4)? };
        let bytes = self.bytes;
        Some((0..count).map(move |k| {
            let at = first + 4 * k;
            Table::at(bytes, at.checked_add(u32_at(bytes, at)? as usize)?)
        }))
    }

    pub fn text(&self, index: usize) -> Option<&'a str> {
        std::str::from_utf8(self.elements(index, 1)?).ok()
    }
}

/// Where a field of the root lies within `bytes`.
#[cfg(test)]
pub(super) fn place_of(bytes: &[u8], identifier: &[u8; 4], index: usize) -> Option<usize> {
    Table::root(bytes, identifier)?.place(index)
}

/// A buffer that is written from its start: vtables come before tables, and vectors after them.
pub(super) struct Builder {
    /// The length in front and everything after it.
    bytes: Vec<u8>,
}

/// Offset, from the length in front, of a place that will hold an offset.
#[derive(Clone, Copy)]
pub(super) struct Pending(usize);

impl Builder {
    /// A buffer whose root is a table of these fields, each `size` bytes; 0 is a field that is absent.
    /// Returns where each field lies.
    pub fn new(mut bytes: Vec<u8>, identifier: &[u8; 4], fields: &[usize]) -> (Self, Vec<Pending>) {
        bytes.clear();
        // Length, offset of the root, identifier.
        bytes.extend([0; 8]);
        bytes.extend(identifier);
        let mut builder = Self { bytes };
        let (at, places) = builder.table(fields);
        let root = (at - 4) as u32;
        builder.put(Pending(4), &root.to_le_bytes());
        (builder, places)
    }

    fn align(&mut self, size: usize) {
        // Readers align from the length in front.
        while !self.bytes.len().is_multiple_of(size) {
            self.bytes.push(0);
        }
    }

    /// Appends a table of fields of zeros.
    pub fn table(&mut self, fields: &[usize]) -> (usize, Vec<Pending>) {
        // Fields lie in falling order of size, so none needs padding, after four bytes of the vtable's
        // distance; those of eight bytes need four more.
        let mut order: Vec<usize> = (0..fields.len()).filter(|k| fields[*k] > 0).collect();
        order.sort_by_key(|k| std::cmp::Reverse(fields[*k]));
        let mut next = if fields.contains(&8) { 8 } else { 4 };
        let mut offsets = vec![0; fields.len()];
        for k in order {
            offsets[k] = next;
            next += fields[k];
        }
        self.align(8);
        let vtable = self.bytes.len();
        self.bytes.extend(((4 + 2 * fields.len()) as u16).to_le_bytes());
        self.bytes.extend((next as u16).to_le_bytes());
        for offset in &offsets {
            self.bytes.extend((*offset as u16).to_le_bytes());
        }
        self.align(8);
        let at = self.bytes.len();
        self.bytes.extend(((at - vtable) as i32).to_le_bytes());
        self.bytes.resize(at + next, 0);
        (at, offsets.into_iter().map(|offset| Pending(at + offset)).collect())
    }

    /// Fills a field.
    pub fn put(&mut self, place: Pending, bytes: &[u8]) {
        if let Some(field) = self.bytes.get_mut(place.0..place.0 + bytes.len()) {
            field.copy_from_slice(bytes);
        }
    }

    fn point(&mut self, place: Pending, at: usize) {
        self.put(place, &((at - place.0) as u32).to_le_bytes());
    }

    /// Appends a vector whose elements are aligned to `alignment`, and lets `place` point to it.
    pub fn vector(&mut self, place: Pending, count: usize, alignment: usize, elements: &[u8]) {
        // The elements are aligned, four bytes after the count.
        while !(self.bytes.len() + 4).is_multiple_of(alignment.max(4)) {
            self.bytes.push(0);
        }
        let at = self.bytes.len();
        self.point(place, at);
        self.bytes.extend((count as u32).to_le_bytes());
        self.bytes.extend(elements);
    }

    /// Appends a vector of `count` offsets, and returns their places.
    pub fn offsets(&mut self, place: Pending, count: usize) -> Vec<Pending> {
        self.vector(place, count, 4, &vec![0; 4 * count]);
        let first = self.bytes.len() - 4 * count;
        (0..count).map(|k| Pending(first + 4 * k)).collect()
    }

    /// Lets `place` point to the table at `at`.
    pub fn point_to_table(&mut self, place: Pending, at: usize) {
        self.point(place, at);
    }

    pub fn text(&mut self, place: Pending, text: &str) {
        self.vector(place, text.len(), 4, text.as_bytes());
        self.bytes.push(0);
    }

    /// The buffer with its length in front.
    pub fn finish(mut self) -> Vec<u8> {
        self.align(4);
        let length = (self.bytes.len() - 4) as u32;
        self.put(Pending(0), &length.to_le_bytes());
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_built_is_read() {
        let (mut builder, places) = Builder::new(Vec::new(), b"TEST", &[8, 2, 0, 4, 4]);
        builder.put(places[0], &(-5_i64).to_le_bytes());
        builder.put(places[1], &7_i16.to_le_bytes());
        builder.text(places[3], "three");
        let inner = builder.offsets(places[4], 2);
        for (k, place) in inner.into_iter().enumerate() {
            let (at, fields) = builder.table(&[4]);
            builder.put(fields[0], &(k as f32 + 0.5).to_le_bytes());
            builder.point_to_table(place, at);
        }
        let bytes = builder.finish();
        let table = |bytes: &[u8]| {
            let table = Table::root(sized(bytes)?, b"TEST")?;
            let inner: Option<Vec<_>> = table.tables(4)?.map(|t| t?.f32(0)).collect();
            Some((table.i64(0)?, table.i16(1)?, table.u8(2), table.text(3)?.to_owned(), inner?))
        };
        assert_eq!(table(&bytes), Some((-5, 7, None, "three".into(), vec![0.5, 1.5])));
        assert!(Table::root(sized(&bytes).unwrap(), b"NOPE").is_none());
        for at in 0..bytes.len() {
            assert!(table(&bytes[..at]).is_none());
            for bit in 0..8 {
                let mut wrong = bytes.clone();
                wrong[at] ^= 1 << bit;
                let _ = table(&wrong);
            }
        }
    }
}
