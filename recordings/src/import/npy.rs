//! NumPy arrays (`.npy`): version 1 and 2 headers, C order, little endian.

use crate::error::{Error, Result};
use std::path::Path;

/// Bytes of the largest file that is read.
const MAX_BYTES: u64 = 1 << 30;

/// An array in f64, whatever it was stored as.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Length along each axis.
    pub shape: Vec<usize>,
    /// Values in C order.
    pub data: Vec<f64>,
}

impl Array {
    /// Reads a file of `f4`, `f8`, `i4`, `i8` or `u1`.
    ///
    /// # Errors
    /// The file cannot be read, is larger than 1 GiB, or is an array of another kind.
    pub fn read(path: &Path) -> Result<Self> {
        let remedy = "save it with numpy.save as little-endian f4, f8, i4, i8 or u1 in C order";
        let length = std::fs::metadata(path).map_err(|e| Error::io(path, e))?.len();
        if length > MAX_BYTES {
            return Err(Error::invalid(path, "the array is larger than 1 GiB", remedy));
        }
        let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
        Self::parse(&bytes).ok_or_else(|| Error::invalid(path, "not an array that can be read", remedy))
    }

    fn parse(bytes: &[u8]) -> Option<Self> {
        let major = *bytes.strip_prefix(b"\x93NUMPY")?.first()?;
        let (start, length) = match major {
            1 => (10, usize::from(u16::from_le_bytes(bytes.get(8..10)?.try_into().ok()?))),
            _ => (12, u32::from_le_bytes(bytes.get(8..12)?.try_into().ok()?) as usize),
        };
        let header = std::str::from_utf8(bytes.get(start..start + length)?).ok()?;
        let field = |name: &str| Some(header.split_once(&format!("'{name}':"))?.1.trim_start());
        if field("fortran_order")?.starts_with("True") {
            return None;
        }
        let kind = field("descr")?.split('\'').nth(1)?;
        let shape = field("shape")?.strip_prefix('(')?.split_once(')')?.0;
        let shape: Vec<usize> =
            shape.split(',').map(str::trim).filter(|s| !s.is_empty()).map(|s| s.parse().ok()).collect::<Option<_>>()?;
        let data = &bytes[start + length..];
        macro_rules! values {
            ($ty:ty) => {
                data.chunks_exact(size_of::<$ty>())
                    .map(|c| Some(<$ty>::from_le_bytes(c.try_into().ok()?) as f64))
                    .collect::<Option<Vec<f64>>>()?
            };
        }
        let data = match kind {
            "<f4" => values!(f32),
            "<f8" => values!(f64),
            "<i4" => values!(i32),
            "<i8" => values!(i64),
            "|u1" => values!(u8),
            _ => return None,
        };
        let expected = shape.iter().try_fold(1usize, |n, length| n.checked_mul(*length))?;
        (data.len() == expected).then_some(Self { shape, data })
    }

    /// Rows of three.
    #[must_use]
    pub fn rgb(&self) -> Vec<[f64; 3]> {
        self.data.as_chunks().0.to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_are_read_and_truncated_ones_refused() {
        let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }";
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend([1.0f32, 2.0, 3.0, 4.0, 5.0, 6.5].iter().flat_map(|x| x.to_le_bytes()));
        let array = Array::parse(&bytes).unwrap();
        assert_eq!((array.shape.as_slice(), array.rgb()), (&[2, 3][..], vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.5]]));
        for n in 0..bytes.len() {
            assert_eq!(Array::parse(&bytes[..n]), None, "{n}");
        }
    }
}
