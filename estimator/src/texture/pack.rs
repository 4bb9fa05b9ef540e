//! Rectangles on a page, in shelves: the highest first, each shelf as high as its first rectangle.

/// Positions of the rectangles.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page {
    /// Width.
    pub width: u32,
    /// Height.
    pub height: u32,
    /// Left top corners: `[rectangle]`.
    pub corners: Vec<[u32; 2]>,
}

/// Packs rectangles (width, height) into the smallest page of at most `max_side` that this finds; `None` if they fit none.
#[must_use]
pub fn pack(sizes: &[[u32; 2]], max_side: u32) -> Option<Page> {
    let widest = sizes.iter().map(|s| s[0]).max().unwrap_or(1);
    let area: u64 = sizes.iter().map(|s| u64::from(s[0]) * u64::from(s[1])).sum();
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse(sizes[i][1]), i));
    let first = (widest.max(area.isqrt() as u32)).next_power_of_two();
    let widths =
        std::iter::successors(Some(first), |w| w.checked_mul(2)).take_while(|w| *w < max_side).chain([max_side]);
    widths.filter(|w| *w >= widest).map(|w| shelves(sizes, &order, w)).find(|page| page.height <= max_side)
}

fn shelves(sizes: &[[u32; 2]], order: &[usize], width: u32) -> Page {
    let mut corners = vec![[0, 0]; sizes.len()];
    let (mut left, mut top, mut shelf) = (0, 0u32, 0);
    for &i in order {
        let [w, h] = sizes[i];
        if left + w > width {
            (left, top) = (0, top.saturating_add(shelf));
            shelf = 0;
        }
        corners[i] = [left, top];
        left += w;
        shelf = shelf.max(h);
    }
    Page { width, height: top.saturating_add(shelf).max(1), corners }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rectangles_lie_on_the_page_and_apart(sizes in proptest::collection::vec((1u32..60, 1u32..60), 1..60)) {
            let sizes: Vec<[u32; 2]> = sizes.into_iter().map(|(w, h)| [w, h]).collect();
            let Some(page) = pack(&sizes, 256) else {
                let area: u32 = sizes.iter().map(|s| s[0] * s[1]).sum();
                prop_assert!(area > 256 * 256 / 4, "{area} texels did not fit");
                return Ok(());
            };
            let mut owner = vec![false; (page.width * page.height) as usize];
            for ([x, y], [w, h]) in page.corners.iter().zip(&sizes) {
                prop_assert!(x + w <= page.width && y + h <= page.height);
                for i in 0..w * h {
                    let at = ((y + i / w) * page.width + x + i % w) as usize;
                    prop_assert!(!std::mem::replace(&mut owner[at], true));
                }
            }
        }
    }

    #[test]
    fn what_fits_no_page_is_refused() {
        assert_eq!(pack(&[[65, 1]], 64), None);
        assert_eq!(pack(&[[64, 33], [64, 33]], 64), None);
        assert!(pack(&[], 64).is_some());
    }
}
