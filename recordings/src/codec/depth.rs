//! Lossless coding of depth images.
//!
//! A structured-light sensor measures disparity in steps, so an image holds a few hundred distinct depths and
//! neighbours mostly share one: depths become indices into a table of the values present, an index is predicted from
//! its left (else upper) neighbour, and the difference is entropy coded (range asymmetric numeral systems, Duda 2013)
//! with frequencies that depend on how the upper neighbours differ from the prediction. The image is cut into
//! `BANDS` bands that are decoded in step: one band alone would wait for its own last pixel much of the time.
//!
//! Layout: `mode u8`; mode 0: the depths, little-endian; mode 1: the value table, the frequency tables, then each
//! band's escaped indices and coded 16-bit words.

use crate::codec::pack::{Input, Words, put_varint};

const RAW: u8 = 0;
const CODED: u8 = 1;

const BANDS: usize = 4;
/// Symbols: 0 no depth, 1..=30 a zigzag difference of 0..=29, 31 an index of its own (escaped).
const SYMBOLS: usize = 32;
const ESCAPE: usize = SYMBOLS - 1;
/// Bits of precision of a frequency.
const PRECISION: u32 = 10;
const TOTAL: u32 = 1 << PRECISION;
/// A state of the coder lies in STATE_LOW .. STATE_LOW << 16.
const STATE_LOW: u32 = 1 << 16;
/// Contexts: 6 × 4 × 4 with a left neighbour, 2³ without.
const CONTEXTS: usize = 104;

/// Neighbours of a pixel, as indices; 0 = none.
#[derive(Clone, Copy)]
struct Neighbours {
    w: u16,
    nw: u16,
    n: u16,
    ne: u16,
}

impl Neighbours {
    /// Predicted index and context.
    #[inline(always)]
    fn predict(self, last: u16) -> (u16, usize) {
        let Self { w, nw, n, ne } = self;
        if w > 0 {
            let near = |v: u16, reach: i32| {
                let difference = (i32::from(v) - i32::from(w)).clamp(-reach, reach) + reach;
                (if v == 0 { 2 * reach + 1 } else { difference }) as usize
            };
            (w, near(n, 2) * 16 + near(ne, 1) * 4 + near(nw, 1))
        } else {
            let predicted = [n, ne, last].into_iter().find(|v| *v > 0).unwrap_or(0);
            (predicted, 96 + usize::from(nw > 0) * 4 + usize::from(n > 0) * 2 + usize::from(ne > 0))
        }
    }
}

/// Rows of band `band`.
fn band_rows(band: usize, height: usize) -> std::ops::Range<usize> {
    band * height / BANDS..(band + 1) * height / BANDS
}

/// Symbols of one band with their contexts, and its escaped indices.
#[derive(Default)]
struct BandSymbols {
    symbols: Vec<(u8, u8)>,
    escapes: Vec<u16>,
}

/// Codes depth images; its tables are kept from frame to frame to save their allocation.
pub(crate) struct DepthEncoder {
    /// `[depth]` → its index among the values present, 0 = none.
    index_of: Vec<u16>,
    counts: Vec<[u32; SYMBOLS]>,
    frequencies: Vec<[u32; SYMBOLS]>,
    cumulative: Vec<[u32; SYMBOLS]>,
    bands: [BandSymbols; BANDS],
    above: Vec<u16>,
    row: Vec<u16>,
    words: Vec<u16>,
}

impl DepthEncoder {
    pub(crate) fn new() -> Self {
        Self {
            index_of: vec![0; 1 << 16],
            counts: vec![[0; SYMBOLS]; CONTEXTS],
            frequencies: Vec::with_capacity(CONTEXTS),
            cumulative: Vec::with_capacity(CONTEXTS),
            bands: Default::default(),
            above: Vec::new(),
            row: Vec::new(),
            words: Vec::new(),
        }
    }

    /// Codes a depth image of this width, appending to `out`.
    pub(crate) fn encode(&mut self, depth: &[u16], width: usize, out: &mut Vec<u8>) {
        let start = out.len();
        out.push(CODED);
        self.encode_indices(depth, width, out);
        if out.len() - start > 2 * depth.len() {
            out.truncate(start);
            out.push(RAW);
            out.extend(depth.iter().flat_map(|d| d.to_le_bytes()));
        }
    }

    fn encode_indices(&mut self, depth: &[u16], width: usize, out: &mut Vec<u8>) {
        self.index_values(depth, out);
        self.find_symbols(depth, width);
        self.frequencies.clear();
        self.frequencies.extend(self.counts.iter().map(normalise));
        self.frequencies.iter().for_each(|f| put_frequencies(out, f));
        self.cumulative.clear();
        self.cumulative.extend(self.frequencies.iter().map(cumulate));
        for band in &self.bands {
            // Coded backwards, because decoding undoes it.
            let mut state = STATE_LOW;
            let words = &mut self.words;
            words.clear();
            for (context, symbol) in band.symbols.iter().rev() {
                let (c, s) = (usize::from(*context), usize::from(*symbol));
                let frequency = self.frequencies[c][s];
                if u64::from(state) >= u64::from(frequency) << (32 - PRECISION) {
                    words.push(state as u16);
                    state >>= 16;
                }
                state = ((state / frequency) << PRECISION) + state % frequency + self.cumulative[c][s];
            }
            words.extend([state as u16, (state >> 16) as u16]);
            words.reverse();
            put_words(out, &band.escapes);
            put_words(out, words);
        }
    }

    /// Numbers the values that occur, and writes their table.
    fn index_values(&mut self, depth: &[u16], out: &mut Vec<u8>) {
        let index_of = &mut self.index_of;
        index_of.fill(0);
        depth.iter().for_each(|d| index_of[usize::from(*d)] = 1);
        index_of[0] = 0;
        put_varint(out, index_of.iter().map(|present| u32::from(*present)).sum());
        let (mut before, mut index) = (0, 0);
        for (value, place) in index_of.iter_mut().enumerate().filter(|(_, present)| **present > 0) {
            put_varint(out, (value - before) as u32);
            (before, index) = (value, index + 1);
            *place = index;
        }
    }

    /// Predicts each pixel, and counts the symbols that correct the predictions.
    fn find_symbols(&mut self, depth: &[u16], width: usize) {
        let Self { index_of, counts, bands, above, row, .. } = self;
        let height = depth.len() / width;
        counts.fill([0; SYMBOLS]);
        for (band, BandSymbols { symbols, escapes }) in bands.iter_mut().enumerate() {
            symbols.clear();
            escapes.clear();
            for line in [&mut *above, &mut *row] {
                line.clear();
                line.resize(width + 2, 0);
            }
            let mut last = 0;
            for y in band_rows(band, height) {
                for x in 0..width {
                    let index = index_of[usize::from(depth[y * width + x])];
                    let near = Neighbours { w: row[x], nw: above[x], n: above[x + 1], ne: above[x + 2] };
                    let (predicted, context) = near.predict(last);
                    let difference = i32::from(index) - i32::from(predicted);
                    let zigzag = ((difference << 1) ^ (difference >> 31)) as usize;
                    let symbol = if index == 0 { 0 } else { (zigzag + 1).min(ESCAPE) };
                    if symbol == ESCAPE {
                        escapes.push(index);
                    }
                    if index > 0 {
                        last = index;
                    }
                    counts[context][symbol] += 1;
                    symbols.push((context as u8, symbol as u8));
                    row[x + 1] = index;
                }
                std::mem::swap(above, row);
            }
        }
    }
}

/// Frequencies that sum to TOTAL, none of a present symbol zero; all zero for a context that never occurs.
fn normalise(counts: &[u32; SYMBOLS]) -> [u32; SYMBOLS] {
    let sum: u64 = counts.iter().map(|c| u64::from(*c)).sum();
    if sum == 0 {
        return [0; SYMBOLS];
    }
    let mut f = counts.map(|c| if c == 0 { 0 } else { ((u64::from(c) * u64::from(TOTAL) / sum) as u32).max(1) });
    // What rounding left over or took too much is the most frequent symbol's, repeatedly, as it may run low.
    loop {
        let total: u32 = f.iter().sum();
        let Some(top) = (0..SYMBOLS).max_by_key(|s| f[*s]) else { return f };
        if total <= TOTAL {
            f[top] += TOTAL - total;
            return f;
        }
        f[top] -= (total - TOTAL).min(f[top] / 2);
    }
}

fn cumulate(frequencies: &[u32; SYMBOLS]) -> [u32; SYMBOLS] {
    let mut sum = 0;
    frequencies.map(|f| {
        sum += f;
        sum - f
    })
}

/// Which symbols occur (one bit each), then their frequencies but for the last, which follows from the sum.
fn put_frequencies(out: &mut Vec<u8>, frequencies: &[u32; SYMBOLS]) {
    let present: Vec<usize> = (0..SYMBOLS).filter(|s| frequencies[*s] > 0).collect();
    put_varint(out, present.iter().fold(0, |mask, s| mask | 1 << s));
    present.iter().rev().skip(1).rev().for_each(|s| put_varint(out, frequencies[*s]));
}

fn put_words(out: &mut Vec<u8>, words: &[u16]) {
    put_varint(out, words.len() as u32);
    out.extend(words.iter().flat_map(|w| w.to_le_bytes()));
}

/// What a state's lowest bits stand for: symbol (5 bits), its frequency (11 bits), and the bits minus the symbol's
/// cumulative frequency (16 bits).
#[derive(Clone, Copy, Default)]
struct Slot(u32);

impl Slot {
    fn new(symbol: u32, frequency: u32, offset: u32) -> Self {
        Self(symbol | frequency << 5 | offset << 16)
    }
}

/// Decoding tables, kept from frame to frame to save their allocation.
pub struct DepthDecoder {
    slots: Vec<[Slot; TOTAL as usize]>,
}

impl Default for DepthDecoder {
    fn default() -> Self {
        Self::new()
    }
}

impl DepthDecoder {
    /// With tables for any image.
    #[must_use]
    pub fn new() -> Self {
        Self { slots: vec![[Slot::default(); TOTAL as usize]; CONTEXTS] }
    }

    /// Decodes an image of `height` rows that the encoder made; `[y][x]` in the unit of the sensor.
    ///
    /// # Errors
    /// What is wrong with the bytes.
    pub fn decode(&mut self, bytes: &[u8], width: usize, height: usize) -> Result<Vec<u16>, String> {
        let mut input = Input(bytes);
        match input.take(1)?[0] {
            RAW if input.0.len() == 2 * width * height => {
                Ok(input.0.as_chunks::<2>().0.iter().map(|b| u16::from_le_bytes(*b)).collect())
            }
            CODED if width > 0 => self.decode_indices(input, width, height),
            _ => Err("depth in no known coding".into()),
        }
    }

    fn decode_indices(&mut self, mut input: Input, width: usize, height: usize) -> Result<Vec<u16>, String> {
        let mut values = vec![0u16];
        for _ in 0..input.varint()? {
            let step = input.varint()?;
            let before = u32::from(values[values.len() - 1]);
            let value = before.checked_add(step).and_then(|v| u16::try_from(v).ok()).filter(|_| step > 0);
            values.push(value.ok_or("depth: bad value table")?);
        }
        for slots in &mut self.slots {
            read_frequencies(&mut input, slots)?;
        }
        let mut depth = vec![0; width * height];
        let mut rest = depth.as_mut_slice();
        let mut bands = Vec::with_capacity(BANDS);
        for band in 0..BANDS {
            let (rows, tail) = rest.split_at_mut(band_rows(band, height).len() * width);
            rest = tail;
            bands.push(Band::new(input.words()?, input.words()?, rows, width)?);
        }
        let mut bands: [Band; BANDS] = bands.try_into().map_err(|_| "depth: bands")?;
        // Bands differ by a row at most.
        let common = height / BANDS;
        for y in 0..common {
            decode_row(&mut bands, width, &self.slots);
            bands.iter_mut().for_each(|band| band.end_row(y, width, &values));
        }
        for band in &mut bands {
            for y in common..band.rows.len() / width {
                decode_row(std::array::from_mut(band), width, &self.slots);
                band.end_row(y, width, &values);
            }
        }
        let whole = bands.iter().all(Band::is_whole);
        if whole { Ok(depth) } else { Err("depth is damaged".into()) }
    }
}

fn read_frequencies(input: &mut Input, slots: &mut [Slot; TOTAL as usize]) -> Result<(), String> {
    let mask = input.varint()?;
    let mut filled = 0;
    for symbol in (0..SYMBOLS as u32).filter(|s| mask >> s & 1 > 0) {
        let is_last = mask >> symbol == 1;
        let frequency = if is_last { TOTAL - filled } else { input.varint()? };
        if frequency == 0 || frequency > TOTAL - filled {
            return Err("depth: bad frequencies".into());
        }
        for offset in 0..frequency {
            slots[(filled + offset) as usize] = Slot::new(symbol, frequency, offset);
        }
        filled += frequency;
    }
    if mask == 0 {
        // A context that never occurs must not decode with a former frame's table.
        slots.fill(Slot::default());
    }
    Ok(())
}

/// Decodes one row of each band, pixel by pixel in step; what changes from pixel to pixel is held in locals.
fn decode_row<const N: usize>(bands: &mut [Band; N], width: usize, slots: &[[Slot; TOTAL as usize]]) {
    let mut states = [0; N];
    let mut lasts = [0; N];
    let mut sound = [true; N];
    // W, NW, N of the next pixel.
    let mut near = [[0u16; 3]; N];
    for (b, band) in bands.iter().enumerate() {
        (states[b], lasts[b], near[b][2]) = (band.state, band.last, band.above[1]);
    }
    for x in 0..width {
        for b in 0..N {
            let band = &mut bands[b];
            let [w, nw, n] = near[b];
            let ne = band.above[x + 2];
            let (predicted, context) = Neighbours { w, nw, n, ne }.predict(lasts[b]);
            let Slot(slot) = slots[context][(states[b] % TOTAL) as usize];
            let mut state = (slot >> 5 & 0x7ff) * (states[b] >> PRECISION) + (slot >> 16);
            if state < STATE_LOW {
                match band.words.next() {
                    Some(word) => state = state << 16 | u32::from(u16::from_le_bytes(*word)),
                    None => sound[b] = false,
                }
            }
            states[b] = state;
            let symbol = slot % SYMBOLS as u32;
            let zigzag = symbol.wrapping_sub(1);
            let mut index = predicted.wrapping_add((zigzag >> 1) as u16 ^ (zigzag & 1).wrapping_neg() as u16);
            if symbol == ESCAPE as u32 {
                let escaped = band.escapes.next().map(|w| u16::from_le_bytes(*w));
                sound[b] &= escaped.is_some();
                index = escaped.unwrap_or(0);
            }
            if symbol == 0 {
                index = 0;
            } else {
                lasts[b] = index;
            }
            band.row[x + 1] = index;
            near[b] = [index, n, ne];
        }
    }
    for (b, band) in bands.iter_mut().enumerate() {
        (band.state, band.last) = (states[b], lasts[b]);
        band.sound &= sound[b];
    }
}

/// One band under way.
struct Band<'a> {
    state: u32,
    escapes: Words<'a>,
    words: Words<'a>,
    /// False once something impossible was read; checked at the end, not at every pixel.
    sound: bool,
    /// Indices of the row above and of this row, each with a 0 on either side.
    above: Vec<u16>,
    row: Vec<u16>,
    last: u16,
    /// Where the depths go.
    rows: &'a mut [u16],
}

impl<'a> Band<'a> {
    fn new(escapes: Words<'a>, mut words: Words<'a>, rows: &'a mut [u16], width: usize) -> Result<Self, String> {
        let mut word = || words.next().map(|w| u32::from(u16::from_le_bytes(*w))).ok_or("the depths end early");
        let state = word()? << 16 | word()?;
        let empty = vec![0; width + 2];
        Ok(Self { state, escapes, words, sound: true, above: empty.clone(), row: empty, last: 0, rows })
    }

    fn end_row(&mut self, y: usize, width: usize, values: &[u16]) {
        for (depth, index) in self.rows[y * width..][..width].iter_mut().zip(&self.row[1..]) {
            match values.get(usize::from(*index)) {
                Some(value) => *depth = *value,
                None => self.sound = false,
            }
        }
        std::mem::swap(&mut self.above, &mut self.row);
    }

    /// True if everything was used up and the coder is back where encoding began.
    fn is_whole(&self) -> bool {
        self.sound && self.state == STATE_LOW && self.words.len() == 0 && self.escapes.len() == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn round_trip(depth: &[u16], width: usize) -> usize {
        let mut bytes = vec![];
        DepthEncoder::new().encode(depth, width, &mut bytes);
        let back = DepthDecoder::new().decode(&bytes, width, depth.len() / width).unwrap();
        assert!(back == depth);
        bytes.len()
    }

    #[test]
    fn extremes_come_back() {
        for depth in
            [vec![0; 12], vec![65535; 12], (0..12).collect(), vec![0, 65535, 0, 1, 65535, 65535, 2, 0, 1, 1, 0, 0]]
        {
            for width in [1, 2, 3, 4, 6, 12] {
                round_trip(&depth, width);
            }
        }
        let every: Vec<u16> = (0..=u16::MAX).collect();
        assert!(round_trip(&every, 256) <= 2 * every.len() + 1);
        let noise: Vec<u16> = (0..65536u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u16).collect();
        assert!(round_trip(&noise, 256) <= 2 * noise.len() + 1);
    }

    fn some_image() -> Vec<u16> {
        (0..40u16 * 30).map(|i| if i % 40 > 30 { 0 } else { 800 + 3 * (i / 40) + i * 7 % 5 + i / 600 * 1000 }).collect()
    }

    proptest! {
        #[test]
        fn every_image_comes_back(
            width in 1usize..40, rows in proptest::collection::vec(proptest::collection::vec(any::<u16>(), 40), 1..20),
            step in 1u16..5000,
        ) {
            let depth: Vec<u16> = rows.iter().flat_map(|r| r[..width].iter().map(|v| v / step * step)).collect();
            round_trip(&depth, width);
        }

        #[test]
        fn damage_never_panics(at in any::<usize>(), bit in 0u8..8, cut in any::<usize>()) {
            let mut bytes = vec![];
            DepthEncoder::new().encode(&some_image(), 40, &mut bytes);
            let mut decoder = DepthDecoder::new();
            let _ = decoder.decode(&bytes[..cut % bytes.len()], 40, 30).unwrap_err();
            let at = at % bytes.len();
            bytes[at] ^= 1 << bit;
            let _ = decoder.decode(&bytes, 40, 30);
            bytes[at] ^= 1 << bit;
            prop_assert_eq!(decoder.decode(&bytes, 40, 30).unwrap(), some_image());
            prop_assert!(decoder.decode(&bytes, 30, 41).is_err());
            prop_assert!(decoder.decode(&bytes, 0, 30).is_err());
        }

        #[test]
        fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
            let _ = DepthDecoder::new().decode(&bytes, 8, 5);
        }
    }
}
