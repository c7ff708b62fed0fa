//! Bytes: the GLB container, buffers, URIs.

use std::borrow::Cow;
use std::path::Path;

use evis_limits::Budget;

/// JSON and binary chunk of a file; a `.gltf` is JSON only.
pub(super) fn split(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    let Some(content) = bytes.strip_prefix(b"glTF") else {
        let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let first = text.iter().find(|b| !b.is_ascii_whitespace());
        return match first {
            Some(b'{') => Ok((text, None)),
            _ => {
                let start: Vec<_> = bytes.iter().take(4).map(|b| format!("{b:02x}")).collect();
                Err(format!(
                    "it is neither GLB (which starts with 'glTF') nor JSON: its {} bytes start with [{}]",
                    bytes.len(),
                    start.join(" ")
                ))
            }
        };
    };
    let version = word(content, 0).ok_or_else(|| truncated(bytes.len(), "its header"))?;
    if version != 2 {
        return Err(format!("it is GLB version {version}; version 2 works"));
    }
    let length = word(content, 4).ok_or_else(|| truncated(bytes.len(), "its header"))? as usize;
    let content = bytes.get(12..length).ok_or_else(|| {
        format!("it is truncated or damaged: its header gives {length} bytes, the file has {}", bytes.len())
    })?;
    let (json, rest) = chunk(content, bytes.len())?;
    if json.0 != *b"JSON" {
        return Err(format!("its first chunk is '{}', not JSON", json.0.escape_ascii()));
    }
    let mut rest = rest;
    while !rest.is_empty() {
        let (next, after) = chunk(rest, bytes.len())?;
        if next.0 == *b"BIN\0" {
            return Ok((json.1, Some(next.1)));
        }
        rest = after;
    }
    Ok((json.1, None))
}

fn truncated(length: usize, what: &str) -> String {
    format!("it is truncated: its {length} bytes end within {what}")
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

type Chunk<'a> = ([u8; 4], &'a [u8]);

/// The first chunk (kind and content), and what follows it.
fn chunk(bytes: &[u8], file_length: usize) -> Result<(Chunk<'_>, &[u8]), String> {
    let header =
        word(bytes, 0).zip(word(bytes, 4)).ok_or_else(|| truncated(file_length, "the header of a chunk"))?;
    let content = &bytes[8..];
    let (content, rest) =
        content.split_at_checked(header.0 as usize).ok_or_else(|| truncated(file_length, "a chunk"))?;
    Ok(((header.1.to_le_bytes(), content), rest))
}

/// Content of buffer `index`.
pub(super) fn buffer(
    index: usize,
    uri: Option<&str>,
    byte_length: u64,
    folder: &Path,
    binary: Option<&[u8]>,
    budget: &Budget,
) -> Result<Vec<u8>, String> {
    let what = format!("buffer {index}");
    let mut content = match (uri, binary) {
        (Some(uri), _) => fetch(uri, folder, &what, budget)?,
        (None, Some(binary)) if index == 0 => {
            budget.take(binary.len() as u64, &what)?;
            binary.to_vec()
        }
        _ => return Err(format!("{what} has no content: neither a URI nor the binary chunk of a GLB")),
    };
    // Chunks are padded; a buffer ends where it says.
    match usize::try_from(byte_length) {
        Ok(length) if length <= content.len() => content.truncate(length),
        _ => return Err(format!("{what} should have {byte_length} bytes, but has {}", content.len())),
    }
    Ok(content)
}

/// Content behind a URI: inline data, or a file relative to `folder`.
pub(super) fn fetch(uri: &str, folder: &Path, what: &str, budget: &Budget) -> Result<Vec<u8>, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (kind, data) =
            data.split_once(',').ok_or_else(|| format!("{what} has a data URI without data"))?;
        budget.take(data.len() as u64, what)?;
        return if kind.ends_with(";base64") {
            base64(data.as_bytes()).ok_or_else(|| format!("{what} has a data URI that is not valid base64"))
        } else {
            Ok(percent_decoded(data).into_owned())
        };
    }
    if uri.contains("://") {
        return Err(format!("{what} lies at {uri}; only files beside the scene and data URIs are read"));
    }
    let decoded = percent_decoded(uri);
    let relative =
        std::str::from_utf8(&decoded).map_err(|_| format!("{what} has the URI '{uri}', no valid text"))?;
    let inside = [relative, uri].into_iter().all(|name| evis_limits::stays_inside(Path::new(name)));
    if !inside && !evis_limits::allow_outside() {
        return Err(format!(
            "{what} has the URI '{uri}', which leaves the scene's folder; `allow_outside` lets scenes that you trust do so"
        ));
    }
    // Some exporters write names as they are, percent signs included.
    let candidates = [folder.join(relative), folder.join(uri)];
    let path = candidates.iter().find(|p| p.exists()).unwrap_or(&candidates[0]);
    evis_limits::read_file(path, budget)
        .map_err(|e| format!("{what} needs the file {}, which cannot be read: {e}", path.display()))
}

fn percent_decoded(text: &str) -> Cow<'_, [u8]> {
    if !text.contains('%') {
        return Cow::Borrowed(text.as_bytes());
    }
    let bytes = text.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while let Some(&byte) = bytes.get(at) {
        let digit = |k: usize| bytes.get(at + k).and_then(|b| char::from(*b).to_digit(16));
        match (byte, digit(1), digit(2)) {
            (b'%', Some(high), Some(low)) => {
                out.push((high * 16 + low) as u8);
                at += 3;
            }
            _ => {
                out.push(byte);
                at += 1;
            }
        }
    }
    Cow::Owned(out)
}

/// RFC 4648, section 4 and 5; padding may be missing.
fn base64(text: &[u8]) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(text.len() / 4 * 3 + 3);
    let (mut bits, mut held) = (0_u32, 0);
    let end = text.iter().rposition(|b| *b != b'=').map_or(0, |last| last + 1);
    for byte in text[..end].iter().filter(|b| !b.is_ascii_whitespace()) {
        let value = match byte {
            b'A'..=b'Z' => byte - b'A',
            b'a'..=b'z' => byte - b'a' + 26,
            b'0'..=b'9' => byte - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            _ => return None,
        };
        bits = (bits << 6 | u32::from(value)) & 0xff_ffff;
        held += 6;
        if held >= 8 {
            held -= 8;
            out.push((bits >> held) as u8);
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_matches_the_vectors_of_rfc_4648() {
        for (text, encoded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg"),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(encoded.as_bytes()).as_deref(), Some(text.as_bytes()));
        }
        assert_eq!(base64(b"-_+/").as_deref(), Some(&[0xfb, 0xff, 0xbf][..]));
        assert_eq!(base64(b"Zm9*"), None);
    }

    #[test]
    fn percent_signs_are_decoded_only_before_two_digits() {
        assert_eq!(percent_decoded("a%20b%2Fc%zz%4").as_ref(), b"a b/c%zz%4");
    }
}
