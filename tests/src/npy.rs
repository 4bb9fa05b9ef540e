//! NumPy arrays, as far as the truth scenes use them: version 1 and 2 headers, C order, little endian.

use std::path::Path;

/// An array in f64, whatever it was stored as.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Length along each axis.
    pub shape: Vec<usize>,
    /// Values in C order.
    pub data: Vec<f64>,
}

impl Array {
    /// Reads a file.
    ///
    /// # Panics
    /// The file is missing or of an unsupported kind.
    #[must_use]
    pub fn read(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        Self::parse(&bytes).unwrap_or_else(|| panic!("{}: not an array that can be read", path.display()))
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
        (data.len() == shape.iter().product::<usize>()).then_some(Self { shape, data })
    }

    /// Rows of three.
    #[must_use]
    pub fn rgb(&self) -> Vec<[f64; 3]> {
        self.data.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect()
    }
}
