//! Packed number arrays: differences in an order in which neighbours are alike, cut into byte planes, and each plane
//! through LZ4 where that helps.

/// Appends a number of up to 32 bits, seven a byte.
pub(crate) fn put_varint(out: &mut Vec<u8>, mut value: u32) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Reads what was put, checking every length.
pub(crate) struct Input<'a>(pub &'a [u8]);

impl<'a> Input<'a> {
    pub(crate) fn take(&mut self, n: usize) -> Result<&'a [u8], String> {
        let (head, tail) = self.0.split_at_checked(n).ok_or("the data end early")?;
        self.0 = tail;
        Ok(head)
    }

    pub(crate) fn varint(&mut self) -> Result<u32, String> {
        let mut value = 0u32;
        for shift in [0, 7, 14, 21, 28] {
            let byte = self.take(1)?[0];
            value |= u32::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err("a number without end".into())
    }

    /// Little-endian 16-bit words, their number in front.
    pub(crate) fn words(&mut self) -> Result<Words<'a>, String> {
        let n = self.varint()? as usize;
        Ok(self.take(n.checked_mul(2).ok_or("the data end early")?)?.as_chunks::<2>().0.iter())
    }
}

/// Little-endian 16-bit words.
pub(crate) type Words<'a> = std::slice::Iter<'a, [u8; 2]>;

/// Appends bytes, compressed if that is shorter: length, LZ4 length (0 = as they are), bytes.
pub(crate) fn put_bytes(out: &mut Vec<u8>, bytes: &[u8]) {
    put_varint(out, bytes.len() as u32);
    let packed = lz4_flex::block::compress(bytes);
    if packed.len() < bytes.len() {
        put_varint(out, packed.len() as u32);
        out.extend(packed);
    } else {
        put_varint(out, 0);
        out.extend(bytes);
    }
}

/// Reads bytes of [`put_bytes`], which must be `expected` many.
pub(crate) fn take_bytes(input: &mut Input, expected: usize) -> Result<Vec<u8>, String> {
    if input.varint()? as usize != expected {
        return Err("an array of another length than announced".into());
    }
    let packed = input.varint()? as usize;
    if packed == 0 {
        return Ok(input.take(expected)?.to_vec());
    }
    let packed = input.take(packed)?;
    // LZ4 expands 255-fold at most: what is announced is only believed as far as that.
    if expected / 256 > packed.len() {
        return Err("an array longer than its data".into());
    }
    let bytes = lz4_flex::block::decompress(packed, expected).map_err(|e| e.to_string())?;
    if bytes.len() == expected { Ok(bytes) } else { Err("an array of another length than announced".into()) }
}

/// Appends numbers of `bits` bits (9 to 16): low bytes, then what is above them (two in a byte if `bits` ≤ 12).
pub(crate) fn put_numbers(out: &mut Vec<u8>, values: &[u16], bits: u32) {
    let mut before = 0u16;
    let mask = u16::MAX >> (16 - bits);
    let differences: Vec<u16> = values
        .iter()
        .map(|v| {
            // The difference modulo 2^bits, small ones of either sign near zero.
            let difference = v.wrapping_sub(before) << (16 - bits);
            before = *v;
            let signed = difference as i16 >> (16 - bits);
            ((signed << 1) ^ (signed >> 15)) as u16 & mask
        })
        .collect();
    let low: Vec<u8> = differences.iter().map(|d| *d as u8).collect();
    let high: Vec<u8> = differences.iter().map(|d| (d >> 8) as u8).collect();
    put_bytes(out, &low);
    if bits <= 12 {
        let pairs = high.chunks(2).map(|p| p[0] | p.get(1).unwrap_or(&0) << 4);
        put_bytes(out, &pairs.collect::<Vec<u8>>());
    } else {
        put_bytes(out, &high);
    }
}

/// Reads `count` numbers of [`put_numbers`].
pub(crate) fn take_numbers(input: &mut Input, count: usize, bits: u32) -> Result<Vec<u16>, String> {
    let low = take_bytes(input, count)?;
    let high = if bits <= 12 {
        let pairs = take_bytes(input, count.div_ceil(2))?;
        pairs.iter().flat_map(|p| [p & 15, p >> 4]).collect()
    } else {
        take_bytes(input, count)?
    };
    let mask = u16::MAX >> (16 - bits);
    let mut before = 0u16;
    Ok(low
        .iter()
        .zip(high)
        .map(|(low, high)| {
            let code = u16::from(*low) | u16::from(high) << 8;
            let signed = (code >> 1) ^ (code & 1).wrapping_neg();
            before = before.wrapping_add(signed) & mask;
            before
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_come_back(values in proptest::collection::vec(any::<u16>(), 0..300), bits in 9u32..=16, smooth in any::<bool>()) {
            let mask = u16::MAX >> (16 - bits);
            let values: Vec<u16> = values.iter().map(|v| if smooth { v % 7 } else { *v } & mask).collect();
            let mut out = vec![];
            put_numbers(&mut out, &values, bits);
            let mut input = Input(&out);
            prop_assert_eq!(take_numbers(&mut input, values.len(), bits).unwrap(), values.clone());
            prop_assert!(input.0.is_empty());
            prop_assert!(take_numbers(&mut Input(&out), values.len() + 2, bits).is_err());
        }

        #[test]
        fn damage_never_panics(values in proptest::collection::vec(0u16..9, 1..300), at in any::<usize>(), value in any::<u8>()) {
            let mut out = vec![];
            put_numbers(&mut out, &values, 12);
            let at = at % out.len();
            prop_assert!(take_numbers(&mut Input(&out[..at]), values.len(), 12).is_err());
            out[at] = value;
            let _ = take_numbers(&mut Input(&out), values.len(), 12);
        }

        #[test]
        fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..100), count in 0usize..1_000_000_000) {
            let _ = take_numbers(&mut Input(&bytes), count, 16);
        }
    }
}
