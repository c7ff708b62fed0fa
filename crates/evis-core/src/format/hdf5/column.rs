//! Data sets that rows are appended to: chunks, and HDF5's extensible array that indexes them.

use std::ops::Range;
use std::path::Path;
use std::time::{Duration, Instant};

use rust_hdf5::FilterPipeline;
use rust_hdf5::format::checksum::checksum_metadata;
use rust_hdf5::format::chunk_index::extensible_array::{
    EA_CLS_FILT_CHUNK, EaChunkLoc, EaDblkPath, EaGeometry, EaLoc, ExtensibleArrayHeader,
    ExtensibleArraySuperBlock, FilteredChunkEntry, FilteredDataBlock, FilteredIndexBlock,
    compute_chunk_size_len,
};
use rust_hdf5::format::messages::data_layout::DataLayoutMessage;
use rust_hdf5::format::messages::dataspace::DataspaceMessage;
use rust_hdf5::format::messages::datatype::DatatypeMessage;
use rust_hdf5::format::messages::filter::{apply_filters, reverse_filters_masked_bounded};
use rust_hdf5::format::messages::{MSG_DATA_LAYOUT, MSG_DATASPACE, MSG_DATATYPE, MSG_FILTER_PIPELINE};

use super::LARGEST_EXPANSION;
use super::store::Store;
use crate::format::FormatError;

/// How long a block that an index no longer names stays untouched.
const RETIRED_FOR: Duration = Duration::from_secs(10);
/// "No address" in HDF5.
const UNDEFINED: u64 = u64::MAX;

/// The part of the chunk index that is being filled: a data block, or one page of a large one.
struct Leaf {
    address: u64,
    /// First chunk that it indexes.
    first: u64,
    elements: Vec<FilteredChunkEntry>,
    /// The header of a data block; `None` for a page, which is bare elements.
    block_offset: Option<u64>,
    dirty: bool,
}

/// A super block that is being filled.
struct Upper {
    address: u64,
    index: usize,
    block: ExtensibleArraySuperBlock,
    dirty: bool,
}

/// Where an unfinished chunk is kept.
struct Spare {
    address: u64,
    capacity: u64,
    retired: Instant,
}

/// A chunked, filtered data set with an unlimited first axis, open for appending.
pub(super) struct Column {
    name: String,
    header_address: u64,
    /// The object header's first block, kept to rewrite the extent and the checksum.
    header_image: Vec<u8>,
    /// Where in the image the first dimension is.
    extent_at: usize,
    row_bytes: usize,
    rows_per_chunk: usize,
    pipeline: FilterPipeline,
    index_address: u64,
    index: ExtensibleArrayHeader,
    root: FilteredIndexBlock,
    geometry: EaGeometry,
    size_field: u8,
    upper: Option<Upper>,
    leaf: Option<Leaf>,
    index_dirty: bool,
    /// Whole chunks in the file.
    chunks: u64,
    /// Bytes of the unfinished chunk.
    tail: Vec<u8>,
    /// Chunks that are full but not yet compressed.
    full: Vec<Vec<u8>>,
    /// Rows of the tail that the last commit stored.
    tail_rows_stored: usize,
    /// Rows that the extent on disk promises.
    rows_published: u64,
    current: Option<Spare>,
    retired: Vec<Spare>,
}

impl Column {
    /// Opens the data set `name`. One that has rows continues where [`Column::resume`] says.
    pub fn open(store: &mut Store, name: &str) -> Result<Self, FormatError> {
        let address = store.find(name)?.ok_or_else(|| store.damaged(format!("it has no {name}")))?;
        let (messages, image) = store.header(address)?;
        let wrong = |store: &Store| {
            store.damaged(format!("{name} is not a compressed data set that EVIS can append to"))
        };
        let message = |kind| messages.iter().find(|m| m.msg_type == kind);
        let context = store.context;

        let space = message(MSG_DATASPACE).ok_or_else(|| wrong(store))?;
        let (dataspace, _) = DataspaceMessage::decode(&space.data, &context).map_err(|_| wrong(store))?;
        let datatype = message(MSG_DATATYPE)
            .and_then(|m| DatatypeMessage::decode(&m.data, &context).ok())
            .ok_or_else(|| wrong(store))?
            .0;
        let pipeline = message(MSG_FILTER_PIPELINE)
            .and_then(|m| FilterPipeline::decode(&m.data).ok())
            .ok_or_else(|| wrong(store))?
            .0;
        let layout = message(MSG_DATA_LAYOUT)
            .and_then(|m| DataLayoutMessage::decode(&m.data, &context).ok())
            .ok_or_else(|| wrong(store))?
            .0;
        let DataLayoutMessage::ChunkedV4 { chunk_dims, index_address, earray_params: Some(_), .. } = layout
        else {
            return Err(wrong(store));
        };

        // One chunk spans every axis but the first.
        let element_bytes = datatype.element_size() as usize;
        let (Some((&rows, frame)), Some((&rows_per_chunk, chunk_frame))) =
            (dataspace.dims.split_first(), chunk_dims.split_first())
        else {
            return Err(wrong(store));
        };
        let frame_matches = chunk_frame.split_last().is_some_and(|(_, dims)| dims == frame);
        let row_bytes = frame
            .iter()
            .try_fold(element_bytes, |bytes, &d| bytes.checked_mul(usize::try_from(d).ok()?))
            .filter(|&bytes| bytes > 0)
            .ok_or_else(|| wrong(store))?;
        let rows_per_chunk = usize::try_from(rows_per_chunk).unwrap_or(0);
        let chunk_bytes = row_bytes.checked_mul(rows_per_chunk).filter(|b| (1..1 << 32).contains(b));
        let (true, Some(chunk_bytes)) = (frame_matches, chunk_bytes) else {
            return Err(wrong(store));
        };

        // What no file of this length holds, and what no reader decodes.
        let rows_there = store.end.saturating_mul(LARGEST_EXPANSION) / row_bytes as u64;
        if rows > rows_there || chunk_bytes as u64 > evis_limits::memory_limit() / 4 {
            return Err(store.damaged(format!("{name} promises more than the file holds")));
        }

        // The extent is the first value of the dataspace message: version 2 has it after 4 bytes.
        let at = position(&image, &space.data).ok_or_else(|| wrong(store))?;
        let extent_at = at + 4;
        if space.data.first() != Some(&2)
            || image.get(extent_at..extent_at + 8) != Some(rows.to_le_bytes().as_slice())
        {
            return Err(wrong(store));
        }

        let index = store.read_at(index_address, 256)?;
        let index = ExtensibleArrayHeader::decode(&index, &context)
            .map_err(|e| store.damaged(format!("the chunk index of {name} is damaged ({e})")))?;
        let geometry = EaGeometry::new(
            index.idx_blk_elmts,
            index.data_blk_min_elmts,
            index.sup_blk_min_data_ptrs,
            index.max_nelmts_bits,
            index.max_dblk_page_nelmts_bits,
        )
        .map_err(|_| wrong(store))?;
        let size_field = compute_chunk_size_len(chunk_bytes as u64);
        if index.class_id != EA_CLS_FILT_CHUNK
            || index.raw_elmt_size != FilteredChunkEntry::raw_size(8, size_field)
        {
            return Err(wrong(store));
        }
        let root = store.read_at(index.idx_blk_addr, 4096)?;
        let root = FilteredIndexBlock::decode(
            &root,
            &context,
            usize::from(index.idx_blk_elmts),
            geometry.ndblk_addrs,
            geometry.nsblk_addrs,
            size_field,
        )
        .map_err(|e| store.damaged(format!("the chunk index of {name} is damaged ({e})")))?;

        Ok(Self {
            name: name.into(),
            header_address: address,
            header_image: image,
            extent_at,
            row_bytes,
            rows_per_chunk,
            pipeline,
            index_address,
            index,
            root,
            geometry,
            size_field,
            upper: None,
            leaf: None,
            index_dirty: false,
            chunks: rows / rows_per_chunk as u64,
            tail: Vec::new(),
            full: Vec::new(),
            tail_rows_stored: 0,
            rows_published: rows,
            current: None,
            retired: Vec::new(),
        })
    }

    fn chunk_bytes(&self) -> usize {
        self.row_bytes * self.rows_per_chunk
    }

    /// Rows appended so far, in the file or not.
    pub fn rows(&self) -> u64 {
        (self.chunks + self.full.len() as u64) * self.rows_per_chunk as u64
            + (self.tail.len() / self.row_bytes) as u64
    }

    /// Bytes that wait for compression: what a writer holds in memory.
    pub fn full_chunks(&self) -> usize {
        self.full.len()
    }

    /// Appends whole rows, in memory only.
    pub fn push(&mut self, mut bytes: &[u8]) {
        let capacity = self.chunk_bytes();
        while !bytes.is_empty() {
            let (now, later) = bytes.split_at(bytes.len().min(capacity - self.tail.len()));
            self.tail.extend_from_slice(now);
            self.roll();
            bytes = later;
        }
    }

    /// Appends one value per item, in memory only: for columns of scalars.
    pub fn push_each<const N: usize>(&mut self, values: impl Iterator<Item = [u8; N]>) {
        for value in values {
            self.tail.extend_from_slice(&value);
            self.roll();
        }
    }

    fn roll(&mut self) {
        let capacity = self.chunk_bytes();
        if self.tail.len() >= capacity {
            self.full.push(std::mem::replace(&mut self.tail, Vec::with_capacity(capacity)));
            self.tail_rows_stored = 0;
        }
    }

    /// Takes the full chunks out, with what is needed to compress them on any thread.
    pub fn take_full(&mut self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.full)
    }

    pub fn pipeline(&self) -> &FilterPipeline {
        &self.pipeline
    }

    /// Writes chunks that [`Column::take_full`] gave, compressed by [`compress`], in their order.
    pub fn append_compressed(&mut self, store: &mut Store, chunks: &[Vec<u8>]) -> Result<(), FormatError> {
        for chunk in chunks {
            let address = store.allocate(chunk.len() as u64);
            store.write_at(address, chunk)?;
            let entry = FilteredChunkEntry { addr: address, nbytes: chunk.len() as u64, filter_mask: 0 };
            self.set_entry(store, self.chunks, entry)?;
            self.retire_current();
            self.chunks += 1;
        }
        Ok(())
    }

    fn retire_current(&mut self) {
        if let Some(mut spare) = self.current.take() {
            spare.retired = Instant::now();
            self.retired.push(spare);
        }
    }

    /// The unfinished chunk, padded to its full size, if it holds rows that the file does not.
    pub fn pending_tail(&self) -> Option<Vec<u8>> {
        if self.tail.len() / self.row_bytes == self.tail_rows_stored {
            return None;
        }
        let mut chunk = self.tail.clone();
        chunk.resize(self.chunk_bytes(), 0);
        Some(chunk)
    }

    /// Stores the unfinished chunk, compressed, in a spare block.
    pub fn store_tail(&mut self, store: &mut Store, compressed: &[u8]) -> Result<(), FormatError> {
        let bytes = compressed.len() as u64;
        let usable = |s: &Spare| s.capacity >= bytes && s.retired.elapsed() >= RETIRED_FOR;
        let spare = match self.retired.iter().position(usable) {
            Some(i) => self.retired.swap_remove(i),
            None => {
                let capacity = self.spare_capacity(bytes);
                Spare { address: store.allocate(capacity), capacity, retired: Instant::now() }
            }
        };
        store.write_at(spare.address, compressed)?;
        let entry = FilteredChunkEntry { addr: spare.address, nbytes: bytes, filter_mask: 0 };
        self.set_entry(store, self.chunks, entry)?;
        self.retire_current();
        self.current = Some(spare);
        self.tail_rows_stored = self.tail.len() / self.row_bytes;
        Ok(())
    }

    /// Room for an unfinished chunk of `bytes`, so that later and longer ones fit it too: few blocks then
    /// serve a slow stream for hours.
    fn spare_capacity(&self, bytes: u64) -> u64 {
        let rows = (self.tail.len() / self.row_bytes).max(1) as u64;
        let chunk_rows = self.rows_per_chunk as u64;
        let room = if rows * 16 < chunk_rows { bytes * 2 } else { bytes * chunk_rows / rows };
        (room + room / 8).next_multiple_of(1024)
    }

    /// Writes the chunk index.
    pub fn write_index(&mut self, store: &mut Store) -> Result<(), FormatError> {
        if !self.index_dirty {
            return Ok(());
        }
        self.write_leaf(store)?;
        self.write_upper(store)?;
        store.publish_end()?;
        let root = self.root.encode(&store.context, self.size_field);
        store.write_at(self.index.idx_blk_addr, &root)?;
        let index = self.index.encode(&store.context);
        store.write_at(self.index_address, &index)?;
        self.index_dirty = false;
        Ok(())
    }

    /// Promises every row stored so far. The index must be written before.
    pub fn write_extent(&mut self, store: &mut Store) -> Result<(), FormatError> {
        let rows = self.chunks * self.rows_per_chunk as u64 + self.tail_rows_stored as u64;
        self.set_extent(store, rows)
    }

    fn set_extent(&mut self, store: &mut Store, rows: u64) -> Result<(), FormatError> {
        if rows == self.rows_published {
            return Ok(());
        }
        let sum_at = self.header_image.len().saturating_sub(4);
        if let Some(extent) = self.header_image.get_mut(self.extent_at..self.extent_at + 8) {
            extent.copy_from_slice(&rows.to_le_bytes());
        }
        let sum = checksum_metadata(self.header_image.get(..sum_at).unwrap_or_default());
        if let Some(stored) = self.header_image.get_mut(sum_at..) {
            stored.copy_from_slice(&sum.to_le_bytes());
        }
        store.write_at(self.header_address, &self.header_image)?;
        self.rows_published = rows;
        Ok(())
    }

    /// Calls `visit` with the bytes of `rows`, one chunk at a time.
    pub fn for_each_chunk(
        &mut self,
        store: &mut Store,
        rows: Range<u64>,
        mut visit: impl FnMut(&[u8]),
    ) -> Result<(), FormatError> {
        let per_chunk = self.rows_per_chunk as u64;
        let until = self.rows_published.min(rows.end);
        let mut row = rows.start;
        while row < until {
            let chunk = self.read_chunk(store, row / per_chunk)?;
            let end = until.min((row / per_chunk + 1) * per_chunk);
            let bytes = |r: u64| usize::try_from(r % per_chunk).unwrap_or(0) * self.row_bytes;
            let after = bytes(row) + usize::try_from(end - row).unwrap_or(0) * self.row_bytes;
            visit(chunk.get(bytes(row)..after).unwrap_or_default());
            row = end;
        }
        Ok(())
    }

    /// Bytes of a row.
    pub fn row_bytes(&self) -> usize {
        self.row_bytes
    }

    /// Goes on after row `rows`, shortening the data set if it has more.
    pub fn resume(&mut self, store: &mut Store, rows: u64) -> Result<(), FormatError> {
        let rows = rows.min(self.rows_published);
        self.full.clear();
        self.chunks = rows / self.rows_per_chunk as u64;
        let tail_rows = usize::try_from(rows % self.rows_per_chunk as u64).unwrap_or(0);
        self.tail.clear();
        if tail_rows > 0 {
            self.tail = self.read_chunk(store, self.chunks)?;
            self.tail.truncate(tail_rows * self.row_bytes);
        }
        self.tail_rows_stored = tail_rows;
        self.current = None;
        self.set_extent(store, rows)
    }

    /// Rows that the file promises.
    pub fn rows_published(&self) -> u64 {
        self.rows_published
    }

    /// The content of one chunk, decompressed.
    pub fn read_chunk(&mut self, store: &mut Store, chunk: u64) -> Result<Vec<u8>, FormatError> {
        let entry = self.entry(store, chunk)?;
        self.read_entry(store, chunk, entry)
    }

    fn read_entry(
        &self,
        store: &mut Store,
        chunk: u64,
        entry: FilteredChunkEntry,
    ) -> Result<Vec<u8>, FormatError> {
        let bytes = self.chunk_bytes();
        if entry.is_undef() {
            return Err(store.damaged(format!("{} lacks its chunk {chunk}", self.name)));
        }
        let stored = usize::try_from(entry.nbytes).unwrap_or(usize::MAX);
        let stored = store.read_at(entry.addr, stored.min(bytes.saturating_mul(2) + 1024))?;
        let image = reverse_filters_masked_bounded(&self.pipeline, &stored, entry.filter_mask, bytes)
            .map_err(|e| store.damaged(format!("chunk {chunk} of {} is damaged ({e})", self.name)))?;
        if image.len() == bytes {
            Ok(image)
        } else {
            Err(store.damaged(format!("chunk {chunk} of {} has {} bytes of {bytes}", self.name, image.len())))
        }
    }

    /// Rows whose chunks cannot be read, in order and as far as the extent goes. Every chunk is decompressed.
    pub fn damaged_rows(&mut self, store: &mut Store) -> Vec<Range<u64>> {
        let per_chunk = self.rows_per_chunk as u64;
        let mut damaged: Vec<Range<u64>> = Vec::new();
        for chunk in 0..self.rows_published.div_ceil(per_chunk) {
            if self.read_chunk(store, chunk).is_ok() {
                continue;
            }
            let rows = chunk * per_chunk..self.rows_published.min((chunk + 1) * per_chunk);
            match damaged.last_mut() {
                Some(last) if last.end == rows.start => last.end = rows.end,
                _ => damaged.push(rows),
            }
        }
        damaged
    }

    /// Address and length of a chunk.
    #[cfg(test)]
    pub fn place(&mut self, store: &mut Store, chunk: u64) -> Result<(u64, u64), FormatError> {
        self.entry(store, chunk).map(|entry| (entry.addr, entry.nbytes))
    }

    /// The rows before the first one that cannot be read.
    pub fn readable_rows(&mut self, store: &mut Store) -> u64 {
        self.damaged_rows(store).first().map_or(self.rows_published, |rows| rows.start)
    }

    /// Makes the data set consist of `kept` (in order, apart, within the extent), and commits it. What comes after the first
    /// of them is compressed again, into fresh space.
    pub fn keep(&mut self, store: &mut Store, kept: &[Range<u64>]) -> Result<(), FormatError> {
        let (first, rest) = match kept.split_first() {
            Some((first, rest)) if first.start == 0 => (first.end, rest),
            _ => (0, kept),
        };
        // Before any entry is written, for new ones take the places of old ones.
        let per_chunk = self.rows_per_chunk as u64;
        let mut chunks = Vec::new();
        for rows in rest {
            for chunk in rows.start / per_chunk..rows.end.div_ceil(per_chunk) {
                let start = rows.start.max(chunk * per_chunk) - chunk * per_chunk;
                let end = rows.end.min((chunk + 1) * per_chunk) - chunk * per_chunk;
                chunks.push((chunk, self.entry(store, chunk)?, start as usize..end as usize));
            }
        }
        self.resume(store, first)?;
        for (chunk, entry, rows) in chunks {
            let bytes = self.read_entry(store, chunk, entry)?;
            self.push(bytes.get(rows.start * self.row_bytes..rows.end * self.row_bytes).unwrap_or_default());
            self.store_full(store)?;
        }
        self.commit(store)
    }

    fn store_full(&mut self, store: &mut Store) -> Result<(), FormatError> {
        let path = store.path().to_path_buf();
        let full = self.take_full();
        let full = full.iter().map(|c| compress(&self.pipeline, c, &path)).collect::<Result<Vec<_>, _>>()?;
        self.append_compressed(store, &full)
    }

    /// Stores everything pushed so far, for a column that is written alone.
    pub fn commit(&mut self, store: &mut Store) -> Result<(), FormatError> {
        self.store_full(store)?;
        if let Some(tail) = self.pending_tail() {
            let tail = compress(&self.pipeline, &tail, store.path())?;
            self.store_tail(store, &tail)?;
        }
        self.write_index(store)?;
        self.write_extent(store)
    }

    fn locate(&self, chunk: u64) -> Result<EaLoc, String> {
        self.geometry.locate(chunk).map_err(|_| {
            let most =
                (1_u64 << self.index.max_nelmts_bits.min(63)).saturating_mul(self.rows_per_chunk as u64);
            format!("{} is full at {most} rows", self.name)
        })
    }

    fn entry(&mut self, store: &mut Store, chunk: u64) -> Result<FilteredChunkEntry, FormatError> {
        let found = match self.locate(chunk) {
            Err(_) => None,
            Ok(EaLoc::Index { elem }) => self.root.elements.get(elem).copied(),
            Ok(EaLoc::Dblk(place)) => {
                self.enter(store, chunk, &place, false)?;
                self.leaf
                    .as_ref()
                    .and_then(|leaf| leaf.elements.get(usize::try_from(chunk - leaf.first).ok()?).copied())
            }
        };
        Ok(found.unwrap_or_else(FilteredChunkEntry::undef))
    }

    fn set_entry(
        &mut self,
        store: &mut Store,
        chunk: u64,
        entry: FilteredChunkEntry,
    ) -> Result<(), FormatError> {
        let place = self.locate(chunk).map_err(|what| {
            FormatError::invalid(
                store.path(),
                what,
                "record into several files, each of another part of the time",
            )
        })?;
        let slot = match place {
            EaLoc::Index { elem } => self.root.elements.get_mut(elem),
            EaLoc::Dblk(place) => {
                self.enter(store, chunk, &place, true)?;
                self.leaf.as_mut().and_then(|leaf| {
                    leaf.dirty = true;
                    leaf.elements.get_mut(usize::try_from(chunk - leaf.first).ok()?)
                })
            }
        };
        let Some(slot) = slot else {
            return Err(store.damaged(format!("the chunk index of {} has no place {chunk}", self.name)));
        };
        *slot = entry;
        self.index_dirty = true;
        self.index.max_idx_set = self.index.max_idx_set.max(chunk + 1);
        self.index.num_elmts_realized =
            self.index.num_elmts_realized.max(u64::from(self.index.idx_blk_elmts));
        Ok(())
    }

    /// Makes the leaf that indexes `chunk` the current one, creating it where `create`; without, a
    /// missing leaf leaves none.
    fn enter(
        &mut self,
        store: &mut Store,
        chunk: u64,
        place: &EaChunkLoc,
        create: bool,
    ) -> Result<(), FormatError> {
        let page_rows = self.geometry.dblk_page_nelmts;
        let in_leaf = if place.paged { place.offset_in_dblk % page_rows } else { place.offset_in_dblk };
        let first = chunk - in_leaf;
        if self.leaf.as_ref().is_some_and(|leaf| leaf.first == first) {
            return Ok(());
        }
        self.write_leaf(store)?;
        self.leaf = None;

        // The data block's address, from the root or from a super block.
        let block = match place.path {
            EaDblkPath::Direct { idx } => self.root.dblk_addrs.get(idx).copied(),
            EaDblkPath::ViaSblk { sblk_off, local_dblk, ndblks_in_sblk, sblk_block_offset } => {
                self.enter_upper(store, place, (sblk_off, ndblks_in_sblk, sblk_block_offset), create)?;
                self.upper.as_ref().and_then(|u| u.block.dblk_addrs.get(local_dblk).copied())
            }
        };
        let block = block.unwrap_or(UNDEFINED);
        let element_bytes = usize::from(self.index.raw_elmt_size);
        let bits = self.index.max_nelmts_bits;
        if block == UNDEFINED && !create {
            return Ok(());
        }

        let prefix = self.geometry.dblk_prefix_size(8, bits) as u64;
        let page_bytes = self.geometry.dblk_page_size(element_bytes) as u64;
        let is_new = block == UNDEFINED;
        let block = if !is_new {
            block
        } else {
            let pages = if place.paged { place.dblk_nelmts / page_rows } else { 0 };
            let bytes = if place.paged {
                prefix + pages * page_bytes
            } else {
                prefix + place.dblk_nelmts * element_bytes as u64
            };
            let address = store.allocate(bytes);
            if place.paged {
                // A paged block's own part is the header of one without elements.
                let head = FilteredDataBlock::new(self.index_address, place.dblk_block_offset, 0);
                store.write_at(address, &head.encode(&store.context, bits, self.size_field))?;
            }
            self.index.num_dblks_created += 1;
            self.index.size_dblks_created += bytes;
            self.index.num_elmts_realized += place.dblk_nelmts;
            match place.path {
                EaDblkPath::Direct { idx } => {
                    if let Some(slot) = self.root.dblk_addrs.get_mut(idx) {
                        *slot = address;
                    }
                }
                EaDblkPath::ViaSblk { local_dblk, .. } => {
                    if let Some(upper) = &mut self.upper {
                        upper.dirty = true;
                        if let Some(slot) = upper.block.dblk_addrs.get_mut(local_dblk) {
                            *slot = address;
                        }
                    }
                }
            }
            address
        };

        let leaf = if place.paged {
            let page = place.offset_in_dblk / page_rows;
            let address = block + prefix + page * page_bytes;
            let known = self.mark_page(place, page, create);
            let elements = if known {
                self.read_page(store, address, usize::try_from(page_bytes).unwrap_or(0))?
            } else {
                vec![FilteredChunkEntry::undef(); usize::try_from(page_rows).unwrap_or(0)]
            };
            Leaf { address, first, elements, block_offset: None, dirty: !known }
        } else {
            let rows = usize::try_from(place.dblk_nelmts).unwrap_or(0);
            let elements = if is_new {
                vec![FilteredChunkEntry::undef(); rows]
            } else {
                let bytes = usize::try_from(prefix).unwrap_or(0) + rows * element_bytes;
                let stored = store.read_at(block, bytes)?;
                FilteredDataBlock::decode(&stored, &store.context, bits, rows, self.size_field)
                    .map_err(|e| store.damaged(format!("the chunk index of {} is damaged ({e})", self.name)))?
                    .elements
            };
            Leaf {
                address: block,
                first,
                elements,
                block_offset: Some(place.dblk_block_offset),
                dirty: is_new,
            }
        };
        self.leaf = Some(leaf);
        Ok(())
    }

    /// Makes the super block of `place` the current one.
    fn enter_upper(
        &mut self,
        store: &mut Store,
        place: &EaChunkLoc,
        (slot, blocks, block_offset): (usize, usize, u64),
        create: bool,
    ) -> Result<(), FormatError> {
        if self.upper.as_ref().is_some_and(|upper| upper.index == place.sblk_idx) {
            return Ok(());
        }
        self.write_upper(store)?;
        self.upper = None;
        let bits = self.index.max_nelmts_bits;
        let page_flags = blocks * self.geometry.dblk_page_init_size(place.sblk_idx);
        let address = self.root.sblk_addrs.get(slot).copied().unwrap_or(UNDEFINED);
        if address != UNDEFINED {
            let stored = store.read_at(address, 64 + page_flags + blocks * 8)?;
            let block = ExtensibleArraySuperBlock::decode(&stored, &store.context, bits, blocks, page_flags)
                .map_err(|e| store.damaged(format!("the chunk index of {} is damaged ({e})", self.name)))?;
            self.upper = Some(Upper { address, index: place.sblk_idx, block, dirty: false });
        } else if create {
            let mut block =
                ExtensibleArraySuperBlock::new(EA_CLS_FILT_CHUNK, self.index_address, block_offset, blocks);
            block.page_init = vec![0; page_flags];
            let image = block.encode(&store.context, bits);
            let address = store.allocate(image.len() as u64);
            self.index.num_sblks_created += 1;
            self.index.size_sblks_created += image.len() as u64;
            if let Some(slot) = self.root.sblk_addrs.get_mut(slot) {
                *slot = address;
            }
            self.upper = Some(Upper { address, index: place.sblk_idx, block, dirty: true });
        }
        Ok(())
    }

    /// Whether page `page` of the block at `place` was in use before; where `create`, it is from now on.
    fn mark_page(&mut self, place: &EaChunkLoc, page: u64, create: bool) -> bool {
        let EaDblkPath::ViaSblk { local_dblk, .. } = place.path else { return false };
        let pages = place.dblk_nelmts / self.geometry.dblk_page_nelmts;
        let bit = local_dblk as u64 * pages + page;
        let Some(upper) = &mut self.upper else { return false };
        let Some(byte) = usize::try_from(bit / 8).ok().and_then(|i| upper.block.page_init.get_mut(i)) else {
            return false;
        };
        let mask = 0x80_u8 >> (bit % 8);
        let known = *byte & mask != 0;
        if create && !known {
            *byte |= mask;
            upper.dirty = true;
        }
        known
    }

    fn read_page(
        &self,
        store: &mut Store,
        address: u64,
        bytes: usize,
    ) -> Result<Vec<FilteredChunkEntry>, FormatError> {
        let image = store.read_at(address, bytes)?;
        let (elements, sum) = image.split_at(image.len().saturating_sub(4));
        if image.len() != bytes || sum != checksum_metadata(elements).to_le_bytes() {
            return Err(store.damaged(format!("the chunk index of {} is damaged (page)", self.name)));
        }
        Ok(elements
            .chunks_exact(usize::from(self.index.raw_elmt_size))
            .map(|e| FilteredChunkEntry::decode(e, 8, usize::from(self.size_field)))
            .collect())
    }

    fn write_leaf(&mut self, store: &mut Store) -> Result<(), FormatError> {
        let Some(leaf) = self.leaf.as_mut().filter(|leaf| leaf.dirty) else { return Ok(()) };
        let image = match leaf.block_offset {
            Some(block_offset) => {
                let mut block = FilteredDataBlock::new(self.index_address, block_offset, 0);
                block.elements.clone_from(&leaf.elements);
                block.encode(&store.context, self.index.max_nelmts_bits, self.size_field)
            }
            None => {
                let mut page: Vec<u8> =
                    leaf.elements.iter().flat_map(|e| e.encode(8, usize::from(self.size_field))).collect();
                page.extend_from_slice(&checksum_metadata(&page).to_le_bytes());
                page
            }
        };
        // The entries may point past the end that the last commit published.
        store.publish_end()?;
        store.write_at(leaf.address, &image)?;
        leaf.dirty = false;
        Ok(())
    }

    fn write_upper(&mut self, store: &mut Store) -> Result<(), FormatError> {
        let Some(upper) = self.upper.as_mut().filter(|upper| upper.dirty) else { return Ok(()) };
        let image = upper.block.encode(&store.context, self.index.max_nelmts_bits);
        store.publish_end()?;
        store.write_at(upper.address, &image)?;
        upper.dirty = false;
        Ok(())
    }
}

/// Where `needle` begins in `hay`.
fn position(hay: &[u8], needle: &[u8]) -> Option<usize> {
    hay.windows(needle.len().max(1)).position(|w| w == needle)
}

/// Runs `pipeline` over one chunk.
pub(super) fn compress(pipeline: &FilterPipeline, chunk: &[u8], path: &Path) -> Result<Vec<u8>, FormatError> {
    apply_filters(pipeline, chunk)
        .map_err(|e| FormatError::invalid(path, format!("a chunk cannot be compressed ({e})"), "report this"))
}

#[cfg(test)]
mod tests {
    use super::super::store::FileState;
    use super::*;
    use crate::format::hdf5::{RecordingHeader, RecordingWriter};
    use crate::packet::{CameraInfo, LabelKind};

    /// Every kind of block that HDF5's extensible array has, up to the paged ones that begin with chunk
    /// 131 060, and going on in the middle of each after reopening.
    #[test]
    fn the_chunk_index_grows_through_all_its_levels() {
        let path = std::env::temp_dir().join(format!("evis_index_{}.h5", std::process::id()));
        let camera = CameraInfo::uncalibrated("cam", (1, 1));
        let header = RecordingHeader {
            method: "native".into(),
            labels: vec![LabelKind::Depth],
            ..RecordingHeader::of(vec![camera])
        };
        RecordingWriter::create(&path, &header, true).unwrap().finish("{}").unwrap();

        let mut store = Store::open(&path).unwrap();
        let mut column = Column::open(&mut store, "cam/labels/depth").unwrap();
        // Compressing is slow; seven chunks serve all.
        let value = |i: u64| (i % 7) as f32 + 0.5;
        let chunks: Vec<_> = (0..7)
            .map(|i| vec![compress(column.pipeline(), &value(i).to_le_bytes(), &path).unwrap()])
            .collect();
        let stops = [2, 4, 9, 20, 36, 37, 100, 500, 131_060, 131_061, 132_084, 132_085, 133_200, 134_000];
        let mut row = 0;
        for stop in stops {
            while row < stop {
                column.append_compressed(&mut store, &chunks[(row % 7) as usize]).unwrap();
                row += 1;
            }
            column.write_index(&mut store).unwrap();
            column.write_extent(&mut store).unwrap();
            column = Column::open(&mut store, "cam/labels/depth").unwrap();
            assert_eq!(column.rows_published(), stop);
            column.resume(&mut store, stop).unwrap();
        }
        store.publish(FileState::Closed).unwrap();
        assert_eq!(column.read_chunk(&mut store, 132_500).unwrap(), value(132_500).to_le_bytes());
        assert!(column.read_chunk(&mut store, 134_000).is_err(), "canary: nothing is there");

        // The crate's reader knows nothing of this module.
        let file = rust_hdf5::H5File::open(&path).unwrap();
        let stored = file.dataset("cam/labels/depth").unwrap().read_raw::<f32>().unwrap();
        assert_eq!(stored.len() as u64, row);
        assert!(stored.iter().zip(0..).all(|(&v, i)| v == value(i)));
        if std::env::var_os("EVIS_KEEP_FILES").is_none() {
            std::fs::remove_file(&path).unwrap();
        }
    }
}
