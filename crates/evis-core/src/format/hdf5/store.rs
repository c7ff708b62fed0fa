//! Appending to data sets of an HDF5 file, so that every moment leaves a readable file behind.
//!
//! `rust-hdf5` lays the empty file out and decodes it; this module only appends. The crate's own SWMR
//! writer was tried first: it syncs the disk once per data set and flush, abandons a chunk's old block
//! at each rewrite (a slow stream's file grows thirtyfold) and stops at 131 060 chunks.
//!
//! The rules that make killing the writer harmless, at any instruction:
//! 1. Chunks go to fresh space, never over bytes that a reader may be looking at.
//! 2. A commit writes outside in: chunk data, end of file, chunk index, and the extent last. The extent
//!    never promises a row whose way is not paved.
//! 3. An unfinished chunk is written to a spare block at each commit; a block is used again only
//!    ten seconds later, by when a reader that follows the file has refreshed.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use rust_hdf5::format::dense_link::read_dense_links;
use rust_hdf5::format::messages::data_layout::DataLayoutMessage;
use rust_hdf5::format::messages::link::{LinkMessage, LinkTarget};
use rust_hdf5::format::messages::link_info::LinkInfoMessage;
use rust_hdf5::format::messages::{MSG_DATA_LAYOUT, MSG_LINK, MSG_LINK_INFO, MSG_OBJ_HEADER_CONTINUATION};
use rust_hdf5::format::object_header::{ObjectHeader, ObjectHeaderMessage};
use rust_hdf5::format::superblock::{
    FLAG_SWMR_WRITE, FLAG_WRITE_ACCESS, HDF5_SIGNATURE, SUPERBLOCK_V3, SuperblockV2V3,
};
use rust_hdf5::format::{BlockReader, FormatContext, FormatError as CodecError, FormatResult};

use crate::format::FormatError;

/// Largest object header that is read; ours are below a kilobyte.
const HEADER_LIMIT: usize = 1 << 20;
/// Superblock of version 2 or 3 with 8-byte addresses.
const SUPERBLOCK_BYTES: usize = 48;

/// What the consistency flags of a superblock say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FileState {
    /// A writer is at work, or was killed: readers need `swmr=True`.
    Open,
    /// Closed.
    Closed,
}

/// A file that is being appended to.
pub(super) struct Store {
    file: File,
    /// As its user calls it.
    path: PathBuf,
    /// Where it is, if that is to be checked.
    place: Option<PathBuf>,
    pub(super) context: FormatContext,
    superblock: SuperblockV2V3,
    /// First address that is not in use.
    pub(super) end: u64,
    /// Bytes that the file has on disk.
    on_disk: u64,
    /// Bytes that it had when it was opened.
    found: u64,
    /// Where each write since [`Store::remember`] went, and what was there.
    overwritten: Option<Vec<(u64, Vec<u8>)>>,
    /// Bytes that were written since it was opened.
    #[cfg(test)]
    pub written: u64,
}

impl Store {
    /// Opens `path` for appending. Nothing is written yet.
    pub fn open(path: &Path) -> Result<Self, FormatError> {
        Self::open_as(path, OpenOptions::new().read(true).write(true))
    }

    /// Opens `path` to look at it.
    pub fn open_to_read(path: &Path) -> Result<Self, FormatError> {
        Self::open_as(path, OpenOptions::new().read(true))
    }

    fn open_as(path: &Path, options: &OpenOptions) -> Result<Self, FormatError> {
        let io = |source| FormatError::io(path, "open", source);
        evis_limits::check_regular(&std::fs::metadata(path).map_err(io)?).map_err(io)?;
        let mut file = options.open(path).map_err(io)?;
        let on_disk = file.metadata().map_err(|source| FormatError::io(path, "open", source))?.len();
        let mut head = [0; SUPERBLOCK_BYTES];
        let read =
            read_up_to(&mut file, 0, &mut head).map_err(|source| FormatError::io(path, "read", source))?;
        if head.get(..8) != Some(HDF5_SIGNATURE.as_slice()) {
            return Err(not_ours(path, "it does not start like an HDF5 file"));
        }
        let superblock = SuperblockV2V3::decode(head.get(..read).unwrap_or_default())
            .map_err(|e| not_ours(path, &format!("its superblock is damaged or of another kind ({e})")))?;
        let supported = superblock.version == SUPERBLOCK_V3
            && (superblock.sizeof_offsets, superblock.sizeof_lengths, superblock.base_address) == (8, 8, 0);
        if !supported {
            return Err(not_ours(path, "its superblock was not written by EVIS"));
        }
        // A killed writer leaves bytes past the recorded end; nothing refers to them.
        let end = superblock.end_of_file_address.max(on_disk);
        Ok(Self {
            file,
            path: path.into(),
            place: None,
            context: FormatContext::default_v3(),
            superblock,
            end,
            on_disk,
            found: on_disk,
            overwritten: None,
            #[cfg(test)]
            written: 0,
        })
    }

    /// Tells [`Store::lock_alone`] elsewhere that this file is being written. Readers may still open it:
    /// HDF5 takes the same kind of lock for reading.
    pub fn lock_shared(&self) {
        // A file system without locks is no reason not to write. On Windows a shared lock would forbid
        // our own writes.
        #[cfg(unix)]
        let _ = self.file.try_lock_shared();
    }

    /// Fails if another process has the file open.
    pub fn lock_alone(&self) -> Result<(), FormatError> {
        #[cfg(unix)]
        if matches!(self.file.try_lock(), Err(std::fs::TryLockError::WouldBlock)) {
            return Err(FormatError::invalid(
                &self.path,
                "another process is writing or reading it",
                "wait until that process is done",
            ));
        }
        Ok(())
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Names the file by `path` from now on.
    pub fn is_called(&mut self, path: &Path) {
        self.path = path.into();
    }

    /// The file was moved to `place`; see [`Store::check_place`].
    pub fn moved_to(&mut self, place: &Path) {
        // A process may change its folder.
        self.place = std::path::absolute(place).ok();
    }

    /// Fails where another file has taken this one's place, or none is there any more: nobody will find what is written.
    pub fn check_place(&self) -> Result<(), FormatError> {
        #[cfg(unix)]
        if let Some(place) = &self.place {
            use std::os::unix::fs::MetadataExt;
            let own = self.file.metadata().map_err(|e| self.io("write", e))?;
            let is_own = |there: &std::fs::Metadata| (there.dev(), there.ino()) == (own.dev(), own.ino());
            let what = match std::fs::metadata(place) {
                Ok(there) if is_own(&there) => return Ok(()),
                Ok(_) => "another file took its place while it was written",
                Err(_) => "it was removed while it was written",
            };
            let source = io::Error::other(format!("{what}, and what was written is lost"));
            return Err(FormatError::Lost { path: self.path.clone(), source });
        }
        Ok(())
    }

    /// Whether the file was closed properly.
    pub fn state(&self) -> FileState {
        if self.superblock.file_consistency_flags == 0 { FileState::Closed } else { FileState::Open }
    }

    /// Bytes found on disk, and bytes that the superblock promises, where these are more.
    pub fn missing(&self) -> Option<(u64, u64)> {
        let promised = self.superblock.end_of_file_address;
        (self.found < promised).then_some((self.found, promised))
    }

    /// Keeps what is overwritten from now on, for [`Store::take_back`]. Only for a few small writes.
    pub fn remember(&mut self) {
        self.overwritten = Some(Vec::new());
    }

    /// Makes the file what it was when it was opened; all writes must have been remembered.
    pub fn take_back(&mut self) -> Result<(), FormatError> {
        for (address, bytes) in self.overwritten.take().unwrap_or_default().into_iter().rev() {
            self.write_at(address, &bytes)?;
        }
        self.file.set_len(self.found).map_err(|e| self.io("write", e))
    }

    /// Publishes everything allocated so far as part of the file, whose state stays.
    pub fn publish_end(&mut self) -> Result<(), FormatError> {
        if self.superblock.end_of_file_address == self.end { Ok(()) } else { self.publish(self.state()) }
    }

    /// Writes the superblock: `state`, and everything allocated so far as the end of the file.
    pub fn publish(&mut self, state: FileState) -> Result<(), FormatError> {
        if self.on_disk < self.end {
            self.file.set_len(self.end).map_err(|e| self.io("write", e))?;
            self.on_disk = self.end;
        }
        let mut next = self.superblock.clone();
        next.end_of_file_address = self.end;
        self.write_superblock(next, state)
    }

    /// Marks the file closed without promising anything new: for a writer whose last commit failed.
    pub fn close_as_committed(&mut self) -> Result<(), FormatError> {
        self.write_superblock(self.superblock.clone(), FileState::Closed)
    }

    fn write_superblock(&mut self, mut next: SuperblockV2V3, state: FileState) -> Result<(), FormatError> {
        next.file_consistency_flags = match state {
            FileState::Open => FLAG_WRITE_ACCESS | FLAG_SWMR_WRITE,
            FileState::Closed => 0,
        };
        self.write_at(0, &next.encode())?;
        self.superblock = next;
        Ok(())
    }

    fn io(&self, action: &'static str, source: io::Error) -> FormatError {
        FormatError::io(&self.path, action, source)
    }

    pub(super) fn damaged(&self, what: impl Into<String>) -> FormatError {
        FormatError::corrupt(&self.path, what, "record it again, or copy it again from its source")
    }

    pub(super) fn allocate(&mut self, bytes: u64) -> u64 {
        let address = self.end;
        self.end += bytes;
        address
    }

    pub(super) fn write_at(&mut self, address: u64, bytes: &[u8]) -> Result<(), FormatError> {
        if self.overwritten.is_some() {
            let before = self.read_at(address, bytes.len())?;
            self.overwritten.get_or_insert_default().push((address, before));
        }
        let result = self.file.seek(SeekFrom::Start(address)).and_then(|_| self.file.write_all(bytes));
        result.map_err(|e| self.io("write", e))?;
        #[cfg(test)]
        {
            self.written += bytes.len() as u64;
        }
        self.on_disk = self.on_disk.max(address + bytes.len() as u64);
        Ok(())
    }

    /// Reads at most `bytes` from `address`; less at the end of the file.
    pub(super) fn read_at(&mut self, address: u64, bytes: usize) -> Result<Vec<u8>, FormatError> {
        let left = self.on_disk.saturating_sub(address);
        let mut buffer = vec![0; bytes.min(usize::try_from(left).unwrap_or(usize::MAX))];
        let read = read_up_to(&mut self.file, address, &mut buffer).map_err(|e| self.io("read", e))?;
        buffer.truncate(read);
        Ok(buffer)
    }

    /// The messages of the object header at `address`, continuation blocks included, and the image of
    /// its first block.
    pub(super) fn header(
        &mut self,
        address: u64,
    ) -> Result<(Vec<ObjectHeaderMessage>, Vec<u8>), FormatError> {
        let mut image = self.read_at(address, 4096)?;
        let mut decoded = ObjectHeader::decode(&image);
        if decoded.is_err() {
            image = self.read_at(address, HEADER_LIMIT)?;
            decoded = ObjectHeader::decode(&image);
        }
        let (header, used) =
            decoded.map_err(|e| self.damaged(format!("the object at byte {address} is damaged ({e})")))?;
        image.truncate(used);
        let mut messages = header.messages;
        // Only groups with many links grow a continuation; one level is all that the layout writes.
        let continuations: Vec<_> =
            messages.iter().filter(|m| m.msg_type == MSG_OBJ_HEADER_CONTINUATION).cloned().collect();
        for message in continuations {
            messages.extend(self.continuation(&message.data)?);
        }
        Ok((messages, image))
    }

    fn continuation(&mut self, place: &[u8]) -> Result<Vec<ObjectHeaderMessage>, FormatError> {
        let field = |at: usize| place.get(at..at + 8).and_then(|b| b.try_into().ok()).map(u64::from_le_bytes);
        let (Some(address), Some(length)) = (field(0), field(8)) else {
            return Err(self.damaged("an object's continuation has no address"));
        };
        let length = usize::try_from(length).unwrap_or(usize::MAX).min(HEADER_LIMIT);
        let block = self.read_at(address, length)?;
        let (Some(mut rest), true) =
            (block.get(4..block.len().saturating_sub(4)), block.starts_with(b"OCHK"))
        else {
            return Err(self.damaged(format!("the continuation at byte {address} is damaged")));
        };
        let mut messages = Vec::new();
        while let [msg_type, low, high, flags, tail @ ..] = rest {
            let size = usize::from(u16::from_le_bytes([*low, *high]));
            let (Some(data), Some(next)) = (tail.get(..size), tail.get(size..)) else { break };
            messages.push(ObjectHeaderMessage {
                msg_type: *msg_type,
                flags: *flags,
                creation_index: 0,
                data: data.to_vec(),
            });
            rest = next;
        }
        Ok(messages)
    }

    /// The names in the group `path`; "" is the root, and a group that is missing has none.
    pub fn names(&mut self, path: &str) -> Result<Vec<String>, FormatError> {
        let address = match path {
            "" => Some(self.superblock.root_group_object_header_address),
            _ => self.find(path)?,
        };
        let links = address.map(|a| self.links(a)).transpose()?.unwrap_or_default();
        Ok(links.into_iter().map(|(name, _)| name).collect())
    }

    /// The links of the group at `address`: name and object.
    fn links(&mut self, address: u64) -> Result<Vec<(String, u64)>, FormatError> {
        let (messages, _) = self.header(address)?;
        let mut links = Vec::new();
        for message in messages.iter().filter(|m| m.msg_type == MSG_LINK) {
            let (link, _) = LinkMessage::decode(&message.data, &self.context)
                .map_err(|e| self.damaged(format!("a link is damaged ({e})")))?;
            links.push(link);
        }
        // More than eight links move into a heap of their own.
        for message in messages.iter().filter(|m| m.msg_type == MSG_LINK_INFO) {
            let context = self.context;
            let dense = LinkInfoMessage::decode(&message.data, &context)
                .and_then(|(info, _)| read_dense_links(&info, &context, self))
                .map_err(|e| self.damaged(format!("a group's links are damaged ({e})")))?;
            links.extend(dense);
        }
        Ok(links
            .into_iter()
            .filter_map(|link| match link.target {
                LinkTarget::Hard { address } => Some((link.name, address)),
                _ => None,
            })
            .collect())
    }

    /// The object at `path` ("camera/events/t"), or `None` where a name is missing.
    pub fn find(&mut self, path: &str) -> Result<Option<u64>, FormatError> {
        let mut address = self.superblock.root_group_object_header_address;
        for name in path.split('/') {
            match self.links(address)?.into_iter().find(|(link, _)| link == name) {
                Some((_, target)) => address = target,
                None => return Ok(None),
            }
        }
        Ok(Some(address))
    }

    /// Overwrites the bytes of the contiguous data set `name`; `bytes` must have its exact size.
    pub fn write_contiguous(&mut self, name: &str, bytes: &[u8]) -> Result<(), FormatError> {
        let address = self.find(name)?.ok_or_else(|| self.damaged(format!("it has no {name}")))?;
        let (messages, _) = self.header(address)?;
        let layout = messages
            .iter()
            .find(|m| m.msg_type == MSG_DATA_LAYOUT)
            .and_then(|m| DataLayoutMessage::decode(&m.data, &self.context).ok());
        match layout {
            Some((DataLayoutMessage::Contiguous { address, size }, _))
                if size == bytes.len() as u64 && address < self.end =>
            {
                self.write_at(address, bytes)
            }
            _ => Err(self.damaged(format!("{name} is not a plain value of {} bytes", bytes.len()))),
        }
    }
}

impl BlockReader for Store {
    fn read_block(&mut self, address: u64, bytes: usize) -> FormatResult<Vec<u8>> {
        self.read_at(address, bytes).map_err(|e| CodecError::InvalidData(e.to_string()))
    }
}

fn not_ours(path: &Path, what: &str) -> FormatError {
    FormatError::corrupt(path, what, "give a recording that EVIS wrote")
}

fn read_up_to(file: &mut File, address: u64, buffer: &mut [u8]) -> io::Result<usize> {
    file.seek(SeekFrom::Start(address))?;
    let mut filled = 0;
    while let Some(rest) = buffer.get_mut(filled..).filter(|rest| !rest.is_empty()) {
        match file.read(rest) {
            Ok(0) => break,
            Ok(n) => filled += n,
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(filled)
}
