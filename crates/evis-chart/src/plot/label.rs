//! Where labels go: beside their points, over nothing else.

/// An axis-parallel rectangle; y runs down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rect {
    pub(crate) left: f64,
    pub(crate) top: f64,
    pub(crate) right: f64,
    pub(crate) bottom: f64,
}

impl Rect {
    pub(crate) fn new(left: f64, top: f64, width: f64, height: f64) -> Self {
        Self { left, top, right: left + width, bottom: top + height }
    }

    pub(crate) fn around([x, y]: [f64; 2], half: f64) -> Self {
        Self { left: x - half, top: y - half, right: x + half, bottom: y + half }
    }

    pub(crate) fn width(&self) -> f64 {
        self.right - self.left
    }

    pub(crate) fn height(&self) -> f64 {
        self.bottom - self.top
    }

    pub(crate) fn corners(&self) -> [[f64; 2]; 4] {
        let Self { left, top, right, bottom } = *self;
        [[left, top], [right, top], [right, bottom], [left, bottom]]
    }

    /// Shared area.
    pub(crate) fn overlap(&self, other: &Self) -> f64 {
        let wide = self.right.min(other.right) - self.left.max(other.left);
        let high = self.bottom.min(other.bottom) - self.top.max(other.top);
        wide.max(0.0) * high.max(0.0)
    }

    fn holds(&self, other: &Self) -> bool {
        other.left >= self.left
            && other.right <= self.right
            && other.top >= self.top
            && other.bottom <= self.bottom
    }

    /// The point of it that is nearest to (x, y).
    pub(crate) fn nearest(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [x.clamp(self.left, self.right), y.clamp(self.top, self.bottom)]
    }

    /// Length of the part of the segment from `a` to `b` that lies inside.
    fn cut(&self, a: [f64; 2], b: [f64; 2]) -> f64 {
        let along = [b[0] - a[0], b[1] - a[1]];
        let (mut from, mut to) = (0.0_f64, 1.0_f64);
        for (at, step, low, high) in
            [(a[0], along[0], self.left, self.right), (a[1], along[1], self.top, self.bottom)]
        {
            if step == 0.0 {
                if at < low || at > high {
                    return 0.0;
                }
                continue;
            }
            let (s, t) = ((low - at) / step, (high - at) / step);
            from = from.max(s.min(t));
            to = to.min(s.max(t));
        }
        (to - from).max(0.0) * along[0].hypot(along[1])
    }
}

/// A label to place.
#[derive(Clone, Debug)]
pub(crate) struct Wanted {
    /// The point that it names; for a line, several of its points, the best ones first.
    pub(crate) at: Vec<[f64; 2]>,
    /// From the point's middle to its rim.
    pub(crate) rim: f64,
    pub(crate) width: f64,
    pub(crate) height: f64,
    /// Placed at any distance; others are left out where there is no room beside their point.
    pub(crate) required: bool,
}

/// What labels keep away from.
pub(crate) struct Obstacles<'a> {
    /// Nothing is placed outside.
    pub(crate) bounds: Rect,
    /// Never covered where there is another way.
    pub(crate) solid: &'a [Rect],
    /// Better not crossed.
    pub(crate) lines: &'a [[[f64; 2]; 2]],
}

/// Distances from the point's rim at which a label beside it is tried.
const NEAR: [f64; 3] = [3.0, 7.0, 12.0];

/// A label's place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placed {
    pub(crate) rect: Rect,
    /// The point that it names, of those given.
    pub(crate) at: [f64; 2],
}

/// Places `wanted` in their order: the first ones have the best places. A label that is left out is `None`.
pub(crate) fn place(wanted: &[Wanted], obstacles: &Obstacles<'_>) -> Vec<Option<Placed>> {
    let mut placed: Vec<Rect> = Vec::new();
    let mut leaders: Vec<[[f64; 2]; 2]> = Vec::new();
    let mut out = Vec::new();
    for want in wanted {
        let places = want.at.iter().enumerate().flat_map(|(k, at)| {
            let beside = candidates(want, *at, &obstacles.bounds);
            let cost = |rect: &Rect| k as f64 + cost(rect, *at, want.rim, obstacles, &placed, &leaders);
            beside.map(|rect| (cost(&rect), Placed { rect, at: *at })).collect::<Vec<_>>()
        });
        let best = places
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .filter(|(cost, _)| want.required || *cost < OPTIONAL)
            .map(|(_, placed)| placed);
        if let Some(Placed { rect, at }) = best {
            placed.push(rect);
            leaders.push([at, rect.nearest(at)]);
        }
        out.push(best);
    }
    out
}

/// A cost that no clear place reaches.
const OVERLAP: f64 = 1.0e4;

/// What a label that nobody requires may cost: a few pixels of a line under it, no more.
const OPTIONAL: f64 = 16.0;

fn cost(
    rect: &Rect,
    at: [f64; 2],
    rim: f64,
    obstacles: &Obstacles<'_>,
    placed: &[Rect],
    leaders: &[[[f64; 2]; 2]],
) -> f64 {
    let end = rect.nearest(at);
    let leader = (end[0] - at[0]).hypot(end[1] - at[1]);
    let over = |rects: &[Rect]| rects.iter().map(|r| r.overlap(rect)).sum::<f64>();
    let crossed = |lines: &[[[f64; 2]; 2]]| lines.iter().map(|[a, b]| rect.cut(*a, *b)).sum::<f64>();
    // Never nearer than beside it.
    let tight = (rim + 0.7 * NEAR[0] - leader).max(0.0);
    // A leader that runs through other labels misleads.
    let through = placed.iter().map(|r| r.cut(at, end)).sum::<f64>();
    let covered = over(placed) + over(obstacles.solid);
    let outside = if obstacles.bounds.holds(rect) { 0.0 } else { 1.0 };
    let hard = if covered > 0.0 { OVERLAP * (1.0 + covered) } else { 0.0 };
    // Right of the point and above it is where readers look first.
    let left = if rect.right < at[0] { 0.8 } else { 0.0 };
    let below = if rect.top > at[1] { 0.4 } else { 0.0 };
    hard + outside * OVERLAP * 1.0e6
        + leader
        + 10.0 * tight
        + left
        + below
        + 0.6 * crossed(obstacles.lines)
        + 3.0 * crossed(leaders)
        + 5.0 * through
}

/// Places beside the point, and for required labels all over the bounds.
fn candidates(want: &Wanted, [x, y]: [f64; 2], bounds: &Rect) -> impl Iterator<Item = Rect> + use<> {
    let (w, h, rim) = (want.width, want.height, want.rim);
    // What nobody requires stands so near that it needs no leader, or not at all.
    let gaps = if want.required { NEAR.len() } else { 2 };
    let beside = NEAR.into_iter().take(gaps).flat_map(move |gap| {
        let gap = rim + gap;
        let slant = gap * 0.75;
        [
            Rect::new(x + gap, y - h / 2.0, w, h),
            Rect::new(x - gap - w, y - h / 2.0, w, h),
            Rect::new(x - w / 2.0, y - gap - h, w, h),
            Rect::new(x - w / 2.0, y + gap, w, h),
            Rect::new(x + slant, y - slant - h, w, h),
            Rect::new(x + slant, y + slant, w, h),
            Rect::new(x - slant - w, y - slant - h, w, h),
            Rect::new(x - slant - w, y + slant, w, h),
        ]
    });
    // A grid of half a line's height: fine enough to find every gap that a label fits into.
    let step = h / 2.0;
    let free = [bounds.width() - w, bounds.height() - h];
    let columns = if want.required { (free[0] / step).max(0.0) as usize } else { 0 };
    let rows = if want.required { (free[1] / step).max(0.0) as usize } else { 0 };
    let (left, top) = (bounds.left, bounds.top);
    let anywhere = (0..columns).flat_map(move |column| {
        (0..rows).map(move |row| Rect::new(left + column as f64 * step, top + row as f64 * step, w, h))
    });
    beside.chain(anywhere)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Rect = Rect { left: 0.0, top: 0.0, right: 400.0, bottom: 300.0 };

    fn label(at: [f64; 2]) -> Wanted {
        Wanted { at: vec![at], rim: 4.0, width: 60.0, height: 12.0, required: true }
    }

    fn crowd(count: usize, spread: f64) -> Vec<Wanted> {
        let at = |k: usize| {
            let (a, b) = ((k * 37 % 101) as f64 / 101.0, (k * 53 % 97) as f64 / 97.0);
            [200.0 + (a - 0.5) * spread, 150.0 + (b - 0.5) * spread]
        };
        (0..count).map(|k| label(at(k))).collect()
    }

    fn clashes(rects: &[Rect]) -> usize {
        let pairs = rects.iter().enumerate().flat_map(|(i, a)| rects[..i].iter().map(move |b| (a, b)));
        pairs.filter(|(a, b)| a.overlap(b) > 0.0).count()
    }

    fn rects(placed: &[Option<Placed>]) -> Vec<Rect> {
        placed.iter().flatten().map(|p| p.rect).collect()
    }

    #[test]
    fn crowded_labels_do_not_cover_each_other_or_the_points() {
        let wanted = crowd(30, 80.0);
        let solid: Vec<_> = wanted.iter().map(|w| Rect::around(w.at[0], 4.0)).collect();
        let rects = rects(&place(&wanted, &Obstacles { bounds: BOUNDS, solid: &solid, lines: &[] }));
        assert_eq!(rects.len(), wanted.len(), "required labels are all there");
        assert_eq!(clashes(&rects), 0);
        assert!(rects.iter().all(|r| BOUNDS.holds(r)));
        assert!(rects.iter().all(|r| solid.iter().all(|s| s.overlap(r) == 0.0)));
        let naive: Vec<_> =
            wanted.iter().map(|w| Rect::new(w.at[0][0] + 7.0, w.at[0][1] - 6.0, 60.0, 12.0)).collect();
        assert!(clashes(&naive) > 10, "canary: beside each point they would clash");
    }

    #[test]
    fn labels_that_nobody_requires_are_left_out_where_there_is_no_room() {
        let mut wanted = crowd(30, 20.0);
        wanted.iter_mut().for_each(|w| w.required = false);
        let rects = rects(&place(&wanted, &Obstacles { bounds: BOUNDS, solid: &[], lines: &[] }));
        assert!(!rects.is_empty() && rects.len() < wanted.len());
        assert_eq!(clashes(&rects), 0);
    }

    #[test]
    fn lines_are_avoided_and_have_labels_of_their_own() {
        let free = Obstacles { bounds: BOUNDS, solid: &[], lines: &[] };
        let point = [200.0, 150.0];
        let alone = rects(&place(&[label(point)], &free))[0];
        let middle = [[alone.left, 6.0 + alone.top], [alone.right, 6.0 + alone.top]];
        let avoiding = rects(&place(&[label(point)], &Obstacles { lines: &[middle], ..free }))[0];
        assert!(alone.cut(middle[0], middle[1]) > 50.0, "canary: the line runs through the first choice");
        assert_eq!(avoiding.cut(middle[0], middle[1]), 0.0);

        // Beside its first point there is no room, beside another there is.
        let line: Vec<_> = (0..10).map(|k| [200.0, 20.0 + f64::from(k) * 25.0]).collect();
        let want = Wanted { at: line, rim: 1.0, required: false, ..label(point) };
        let wall = [Rect::new(100.0, 0.0, 200.0, 60.0)];
        let placed = place(&[want], &Obstacles { bounds: BOUNDS, solid: &wall, lines: &[] })[0].unwrap();
        assert!(placed.at[1] > 45.0 && placed.rect.overlap(&wall[0]) == 0.0, "{placed:?}");
    }
}
