//! Packed depth pixels of 10 or 11 bits to one `u16` each.

/// Replaces `raw` by the pixels of `bits` (10 or 11) bits in `packed`, most significant bit first, without padding. An
/// incomplete group of eight at the end is left out.
pub fn unpack(bits: u32, packed: &[u8], raw: &mut Vec<u16>) {
    raw.clear();
    match bits {
        10 => unpack_groups::<10>(packed, raw),
        _ => unpack_groups::<11>(packed, raw),
    }
}

/// With the number of bits known to the compiler.
fn unpack_groups<const BITS: u32>(packed: &[u8], raw: &mut Vec<u16>) {
    // Eight pixels fill `BITS` bytes.
    for group in packed.chunks_exact(BITS as usize) {
        let mut window = [0u8; 16];
        window[16 - BITS as usize..].copy_from_slice(group);
        let bits = u128::from_be_bytes(window);
        for pixel in 0..8 {
            raw.push((bits >> (BITS * (7 - pixel))) as u16 & ((1 << BITS) - 1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::depth_encoder::pack;
    use proptest::prelude::*;

    #[test]
    fn packed_pixels_of_known_bits() {
        let mut raw = Vec::new();
        unpack(11, &[0b1000_0000, 0b0010_0000, 0b0000_1000, 0, 0, 0, 0, 0, 0, 0b0000_0111, 0xff], &mut raw);
        assert_eq!(raw, [1025, 2, 0, 0, 0, 0, 0, 2047]);
        unpack(10, &[0x80, 0x20, 0x0c, 0x03, 0xff, 0, 0, 0, 0, 1], &mut raw);
        assert_eq!(raw, [512, 512, 768, 1023, 0, 0, 0, 1]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn unpacking_undoes_packing(raw in proptest::collection::vec(0u16..1024, 8..200)) {
            let raw = &raw[..raw.len() / 8 * 8];
            let mut out = Vec::new();
            unpack(10, &pack(raw, 10), &mut out);
            prop_assert_eq!(&out, raw);
            let wide: Vec<u16> = raw.iter().map(|r| r * 2 + 1).collect();
            unpack(11, &pack(&wide, 11), &mut out);
            prop_assert_eq!(&out, &wide);
        }
    }
}
