//! Accessors: typed views of buffers, every range checked.

use ::gltf::json::accessor::{ComponentType, Type};
use ::gltf::json::validation::Checked;

use super::document::{Document, element, label};

/// Elements that an accessor without any buffer (all zero) may have.
const MAX_ZEROS: usize = 1 << 22;

/// The elements of an accessor, tightly packed.
pub(super) struct Elements {
    /// Number of elements.
    pub count: usize,
    /// Components of each.
    pub width: usize,
    kind: ComponentType,
    normalized: bool,
    bytes: Vec<u8>,
    label: String,
}

impl Document {
    /// Reads accessor `index` for `user`, which takes elements of `types`.
    pub(super) fn elements(&self, index: usize, types: &[Type], user: &str) -> Result<Elements, String> {
        let accessor = element(&self.root.accessors, "accessor", index, user)?;
        let label = format!("{} ({user})", label("accessor", index, accessor.name.as_ref()));
        let (Checked::Valid(kind), Checked::Valid(type_)) = (accessor.component_type, accessor.type_) else {
            return Err(format!("{label} has an unknown type"));
        };
        if !types.contains(&type_) {
            return Err(format!("{label} holds {type_:?}; {types:?} works"));
        }
        let (kind, width) = (kind.0, type_.multiplicity());
        let size = kind.size() * width;
        let count = usize::try_from(accessor.count.0)
            .map_err(|_| format!("{label} has {} elements", accessor.count.0))?;
        // Packed, and as the numbers that they become; each time that it is used.
        let most = count.saturating_mul(size + width * size_of::<f32>());
        self.budget.take(most as u64, &label)?;
        let offset = accessor.byte_offset.map_or(0, |o| o.0);
        let mut bytes = match accessor.buffer_view {
            Some(view) => self.gather(view.value(), offset, count, size, &label)?,
            None if count <= MAX_ZEROS => vec![0; count * size],
            None => return Err(format!("{label} has {count} elements and no buffer view; {MAX_ZEROS} work")),
        };
        if let Some(sparse) = &accessor.sparse {
            let Checked::Valid(index_kind) = sparse.indices.component_type else {
                return Err(format!("{label} has sparse indices of an unknown type"));
            };
            let changed = usize::try_from(sparse.count.0).unwrap_or(usize::MAX);
            if changed > count {
                return Err(format!("{label} changes {changed} of its {count} elements"));
            }
            let (indices, values) = (&sparse.indices, &sparse.values);
            let index_size = index_kind.0.size();
            let indices =
                self.gather(indices.buffer_view.value(), indices.byte_offset.0, changed, index_size, &label)?;
            let values =
                self.gather(values.buffer_view.value(), values.byte_offset.0, changed, size, &label)?;
            for (at, value) in indices.chunks_exact(index_size).zip(values.chunks_exact(size)) {
                let at = integer(index_kind.0, at) as usize;
                if at >= count {
                    return Err(format!("{label} changes element {at} of {count}"));
                }
                bytes[at * size..(at + 1) * size].copy_from_slice(value);
            }
        }
        Ok(Elements { count, width, kind, normalized: accessor.normalized, bytes, label })
    }

    /// Bytes of buffer view `index`.
    pub(super) fn view(&self, index: usize, user: &str) -> Result<&[u8], String> {
        let view = element(&self.root.buffer_views, "buffer view", index, user)?;
        let content = element(&self.buffers, "buffer", view.buffer.value(), user)?;
        let start = view.byte_offset.map_or(0, |o| o.0);
        range(content, start, view.byte_length.0).ok_or_else(|| {
            let (buffer, length) = (view.buffer.value(), view.byte_length.0);
            format!(
                "buffer view {index} ({user}) has {length} bytes from byte {start} of buffer {buffer}, which has {}",
                content.len()
            )
        })
    }

    /// `count` elements of `size` bytes, packed.
    fn gather(
        &self,
        view: usize,
        offset: u64,
        count: usize,
        size: usize,
        label: &str,
    ) -> Result<Vec<u8>, String> {
        let content = self.view(view, label)?;
        if count == 0 {
            return Ok(Vec::new());
        }
        let stride = self.root.buffer_views.get(view).and_then(|v| v.byte_stride).map_or(size, |s| s.0);
        if stride < size {
            return Err(format!("{label} has elements of {size} bytes at a stride of {stride}"));
        }
        let length = stride.checked_mul(count - 1).and_then(|n| n.checked_add(size));
        let packed = length.and_then(|length| range(content, offset, length as u64));
        let packed = packed.ok_or_else(|| {
            let available = content.len();
            format!(
                "{label} needs {count} elements of {size} bytes at a stride of {stride} from byte {offset} of buffer \
                 view {view}, which has {available} bytes"
            )
        })?;
        Ok(if stride == size {
            packed.to_vec()
        } else {
            // The last element may end before its stride does.
            packed.chunks(stride).flat_map(|chunk| &chunk[..size]).copied().collect()
        })
    }
}

fn range(bytes: &[u8], start: u64, length: u64) -> Option<&[u8]> {
    let start = usize::try_from(start).ok()?;
    bytes.get(start..start.checked_add(usize::try_from(length).ok()?)?)
}

/// Little-endian unsigned integer of a component.
fn integer(kind: ComponentType, bytes: &[u8]) -> u32 {
    let mut word = [0; 4];
    word[..kind.size()].copy_from_slice(&bytes[..kind.size()]);
    u32::from_le_bytes(word)
}

impl Elements {
    /// Components as floats; integers are normalised where the accessor says so, or always.
    pub(super) fn floats(&self, always_normalized: bool) -> Vec<f32> {
        let normalized = self.normalized || always_normalized;
        // glTF 2.0, 3.6.2.2 (animations) and 3.11: c / max, signed values clamped at -1.
        let scaled = |v: f64, max: f64| if normalized { (v / max).max(-1.0) as f32 } else { v as f32 };
        let decode = |b: &[u8]| match self.kind {
            ComponentType::F32 => f32::from_bits(integer(self.kind, b)),
            ComponentType::U8 => scaled(f64::from(b[0]), 255.0),
            ComponentType::I8 => scaled(f64::from(b[0] as i8), 127.0),
            ComponentType::U16 => scaled(f64::from(integer(self.kind, b)), 65_535.0),
            ComponentType::I16 => scaled(f64::from(integer(self.kind, b) as u16 as i16), 32_767.0),
            ComponentType::U32 => scaled(f64::from(integer(self.kind, b)), 4_294_967_295.0),
        };
        self.bytes.chunks_exact(self.kind.size()).map(decode).collect()
    }

    /// Components as unsigned integers.
    pub(super) fn integers(&self) -> Result<Vec<u32>, String> {
        match self.kind {
            ComponentType::U8 | ComponentType::U16 | ComponentType::U32 => {
                Ok(self.bytes.chunks_exact(self.kind.size()).map(|b| integer(self.kind, b)).collect())
            }
            other => Err(format!("{} holds {other:?}; unsigned integers work", self.label)),
        }
    }

    /// Elements of exactly `N` components.
    pub(super) fn vectors<const N: usize>(&self, always_normalized: bool) -> Vec<[f32; N]> {
        let floats = self.floats(always_normalized);
        floats.chunks_exact(self.width).filter_map(|c| c.try_into().ok()).collect()
    }
}
