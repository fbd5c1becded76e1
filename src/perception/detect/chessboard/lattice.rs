//! Links between neighbouring corners of a board, and integer lattice coordinates for each.
//!
//! Two corners are linked when each is the other's nearest along an edge, the colours beside that edge are swapped at them, and
//! all the way between them one side of the edge is light and the other dark.

use crate::imaging::ImageView;
use crate::imaging::corners::RingCorner;

/// No link.
const NONE: u16 = u16::MAX;
/// Shortest link, px of the searched image. Derived: a corner is the greatest response within 3 px in x and y, so that none is nearer.
const SHORTEST_PX: f32 = 3.0;
/// Longest link of a corner in its shortest, so that the search can stop early. Chosen by hand: squares are five times as long as wide where
/// the board is viewed at 12 degrees to its plane; half of it loses boards from 24 degrees on, twice of it costs time.
const LONGEST: f32 = 5.0;
/// How far off a corner's edge the next may lie: tangent, 19 degrees. Chosen by hand: directions read from 16 samples of a ring are good to
/// some degrees, less on small or aslant squares; from 0.41 on (half of 45 degrees) the diagonal is as near.
const ASIDE: f32 = 0.35;
/// Cosine between a link and an edge at its end: 23 degrees. Chosen by hand, a little wider than [`ASIDE`], since the next corner's direction
/// has an error of its own.
const STRAIGHT: f32 = 0.92;
/// Share of the contrast that must remain beside an edge for a link. Chosen by hand: the samples lie between 1 and 3.5 px from the edge,
/// within its blur on small squares; at 0.15 noise passes for an edge, at 0.6 small and blurred squares have no links.
const MIN_CONTRAST: f32 = 0.3;
/// How unlike the contrasts of two neighbours may be. Chosen by hand: light that falls to half from one corner to the next is a shadow's
/// edge; four times would link a board with what lies beside it.
const LIGHT_RATIO: f32 = 2.0;
/// The same for their responses. Chosen by hand, wider than that of the contrasts, since the response also falls where a pixel lies beside the
/// corner, and where squares are small or blurred.
const RESPONSE_RATIO: f32 = 3.0;
/// How unlike the distances to both neighbours on a line may be. Derived: `(z + s) / (z - s)` with `s` the depth of one square, so that 1.5 is
/// a board whose squares, seen edge-on, are a fifth of its distance; a missed corner makes 2.
const STEP_RATIO: f32 = 1.5;

/// A corner and its neighbours.
#[derive(Debug, Clone, Copy)]
struct LatticeNode {
    px: [f32; 2],
    contrast: f32,
    response: f32,
    /// Unit vectors along the edges, by rising angle; opposite ones two apart.
    directions: [[f32; 2]; 4],
    /// Whether edges 0 and 2 (else 1 and 3) are those that become lighter with rising angle.
    even_rises: bool,
    links: [u16; 4],
    /// Connected component, and which of the corner's edges is the lattice's first direction.
    component: u16,
    turn: u8,
    at: [i16; 2],
}

impl LatticeNode {
    fn new(corner: &RingCorner) -> Self {
        let (low, high) = (corner.rising.min(corner.falling), corner.rising.max(corner.falling));
        let (a, b) = ([low.cos(), low.sin()], [high.cos(), high.sin()]);
        let back = |v: [f32; 2]| v.map(|c| -c);
        Self {
            px: [corner.x, corner.y],
            contrast: corner.contrast,
            response: f32::from(corner.response),
            directions: [a, b, back(a), back(b)],
            even_rises: corner.rising <= corner.falling,
            links: [NONE; 4],
            component: NONE,
            turn: 0,
            at: [0; 2],
        }
    }

    fn rises(&self, edge: usize) -> bool {
        self.even_rises == edge.is_multiple_of(2)
    }
}

/// A corner with its lattice coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Placed {
    /// Coordinates along both directions; the second follows the first by a rotation from x to y.
    pub(super) at: [i16; 2],
    /// Position, px of the searched image.
    pub(super) px: [f32; 2],
    /// Whether the square between the two directions is light.
    pub(super) light: bool,
    /// Difference between light and dark, grey levels.
    pub(super) contrast: f32,
}

/// Computes links and lattices. Owns its buffers.
#[derive(Debug, Clone)]
pub(super) struct Links {
    nodes: Vec<LatticeNode>,
    /// Positions of the nodes, side by side.
    px: Vec<[f32; 2]>,
    queue: Vec<u16>,
    /// Number of corners of each component, and how many of its cycles contradict each other.
    components: Vec<(u16, u16)>,
}

impl Links {
    /// For at most `limit` corners; allocated at once.
    pub(super) fn new(limit: usize) -> Self {
        let buffer = || Vec::with_capacity(limit);
        Self {
            nodes: Vec::with_capacity(limit),
            px: Vec::with_capacity(limit),
            queue: buffer(),
            components: Vec::with_capacity(limit),
        }
    }

    /// Links the corners of `image` that are at most `longest_px` from each other.
    pub(super) fn find(&mut self, image: &ImageView<'_>, corners: &[RingCorner], longest_px: f32) {
        self.nodes.clear();
        self.nodes.extend(corners.iter().take(usize::from(NONE) - 1).map(LatticeNode::new));
        self.px.clear();
        self.px.extend(self.nodes.iter().map(|n| n.px));
        for i in 0..self.nodes.len() {
            if let Some(links) = self.nearest(image, i, longest_px)
                && let Some(node) = self.nodes.get_mut(i)
            {
                node.links = links;
            }
        }
        self.keep_mutual();
        self.place();
    }

    /// Number of components, the largest first.
    pub(super) fn components(&self) -> &[(u16, u16)] {
        &self.components
    }

    /// The corners of a component into `out`.
    pub(super) fn component(&self, component: u16, out: &mut Vec<Placed>) {
        out.clear();
        for node in self.nodes.iter().filter(|n| n.component == component) {
            let light = node.rises(usize::from(node.turn));
            out.push(Placed { at: node.at, px: node.px, light, contrast: node.contrast });
        }
    }

    /// The nearest corner along each edge of corner `i`.
    fn nearest(&self, image: &ImageView<'_>, i: usize, longest_px: f32) -> Option<[u16; 4]> {
        let node = self.nodes.get(i)?;
        let mut best = [(f32::INFINITY, NONE); 4];
        let [[ax, ay], [bx, by], ..] = node.directions;
        let mut most = longest_px * longest_px;
        for (j, px) in self.px.iter().enumerate() {
            let (dx, dy) = (px[0] - node.px[0], px[1] - node.px[1]);
            let square = dx * dx + dy * dy;
            if square > most {
                continue;
            }
            // along which edge, if any
            let (along_a, along_b) = (dx * ax + dy * ay, dx * bx + dy * by);
            let (edge, along) = if along_a.abs() > along_b.abs() {
                (if along_a > 0.0 { 0 } else { 2 }, along_a)
            } else {
                (if along_b > 0.0 { 1 } else { 3 }, along_b)
            };
            let along2 = along * along;
            let aside2 = square - along2;
            if aside2 > ASIDE * ASIDE * along2 || along2 < SHORTEST_PX * SHORTEST_PX {
                continue;
            }
            let cost = along2 + 6.0 * aside2;
            let (Some(slot), Some(other)) = (best.get_mut(edge), self.nodes.get(j)) else { continue };
            if cost < slot.0
                && alike(node, other, edge, [dx, dy], square)
                && edge_between(image, node, edge, [dx, dy])
            {
                *slot = (cost, j as u16);
                // nothing further away than the farthest of four, or than tilted squares can be long
                let farthest = best.iter().fold(0.0f32, |m, (c, _)| m.max(*c));
                most = most.min(farthest).min(LONGEST * LONGEST * cost);
            }
        }
        Some(best.map(|(_, j)| j))
    }

    /// Removes links that are not returned, and of two on a line the one that is far too long.
    fn keep_mutual(&mut self) {
        for i in 0..self.nodes.len() {
            for edge in 0..4 {
                if let Some(j) = self.link(i, edge)
                    && self.back(i, j).is_none()
                {
                    self.cut(i, edge);
                }
            }
        }
        for i in 0..self.nodes.len() {
            for edge in 0..2 {
                let (Some(a), Some(b)) = (self.link(i, edge), self.link(i, edge + 2)) else { continue };
                let (la, lb) = (self.distance(i, a), self.distance(i, b));
                if la > STEP_RATIO * lb {
                    self.cut_both(i, edge, a);
                } else if lb > STEP_RATIO * la {
                    self.cut_both(i, edge + 2, b);
                }
            }
        }
    }

    fn link(&self, i: usize, edge: usize) -> Option<usize> {
        let j = *self.nodes.get(i)?.links.get(edge)?;
        (j != NONE).then_some(usize::from(j))
    }

    /// The edge of `j` that leads to `i`.
    fn back(&self, i: usize, j: usize) -> Option<usize> {
        self.nodes.get(j)?.links.iter().position(|&k| usize::from(k) == i)
    }

    fn distance(&self, i: usize, j: usize) -> f32 {
        match (self.nodes.get(i), self.nodes.get(j)) {
            (Some(a), Some(b)) => (a.px[0] - b.px[0]).hypot(a.px[1] - b.px[1]),
            _ => f32::INFINITY,
        }
    }

    fn cut(&mut self, i: usize, edge: usize) {
        if let Some(link) = self.nodes.get_mut(i).and_then(|n| n.links.get_mut(edge)) {
            *link = NONE;
        }
    }

    fn cut_both(&mut self, i: usize, edge: usize, j: usize) {
        if let Some(back) = self.back(i, j) {
            self.cut(j, back);
        }
        self.cut(i, edge);
    }

    /// Assigns lattice coordinates by following the links from corner to corner.
    fn place(&mut self) {
        self.components.clear();
        for start in 0..self.nodes.len() {
            let component = self.components.len() as u16;
            match self.nodes.get_mut(start) {
                Some(node) if node.component == NONE => node.component = component,
                _ => continue,
            }
            let (mut count, mut contradictions) = (1, 0);
            self.queue.clear();
            self.queue.push(start as u16);
            let mut head = 0;
            while let Some(&i) = self.queue.get(head) {
                head += 1;
                let i = usize::from(i);
                let Some(node) = self.nodes.get(i).copied() else { break };
                for edge in 0..4 {
                    let Some(j) = self.link(i, edge) else { continue };
                    let Some(back) = self.back(i, j) else { continue };
                    // the lattice's direction that this edge is, and where it leads
                    let direction = (edge + 4 - usize::from(node.turn)) % 4;
                    let step: [i16; 2] = [[1, 0], [0, 1], [-1, 0], [0, -1]][direction];
                    let at = [node.at[0] + step[0], node.at[1] + step[1]];
                    let turn = ((usize::from(node.turn) + back + 6 - edge) % 4) as u8;
                    let Some(other) = self.nodes.get_mut(j) else { continue };
                    if other.component == NONE {
                        (other.component, other.at, other.turn) = (component, at, turn);
                        count += 1;
                        self.queue.push(j as u16);
                    } else if other.at != at || other.turn != turn {
                        contradictions += 1;
                    }
                }
            }
            self.components.push((count, contradictions));
        }
    }
}

/// Whether a corner at `d` px from `node` along its `edge` can be its neighbour: an edge leads back, with the colours swapped.
fn alike(node: &LatticeNode, other: &LatticeNode, edge: usize, d: [f32; 2], square: f32) -> bool {
    let length = square.sqrt();
    let leads_back = |k: usize| {
        other.directions.get(k).is_some_and(|e| -(e[0] * d[0] + e[1] * d[1]) > STRAIGHT * length)
            && other.rises(k) != node.rises(edge)
    };
    node.contrast < LIGHT_RATIO * other.contrast
        && other.contrast < LIGHT_RATIO * node.contrast
        && node.response < RESPONSE_RATIO * other.response
        && other.response < RESPONSE_RATIO * node.response
        && (0..4).any(leads_back)
}

/// Whether there is an edge all along `d` from a corner, light on the side where the corner's `edge` has it.
fn edge_between(image: &ImageView<'_>, node: &LatticeNode, edge: usize, d: [f32; 2]) -> bool {
    let length = d[0].hypot(d[1]);
    let aside = (0.22 * length).clamp(1.0, 3.5) / length * if node.rises(edge) { 1.0 } else { -1.0 };
    let side = [-d[1] * aside, d[0] * aside];
    let level = |x: f32, y: f32| {
        let (x, y) = (x.round(), y.round());
        if x < 0.0 || y < 0.0 {
            return None;
        }
        image.row(y as usize).get(x as usize).map(|&p| f32::from(p))
    };
    let least = MIN_CONTRAST * node.contrast;
    [0.25, 0.5, 0.75].iter().all(|t| {
        let (x, y) = (node.px[0] + t * d[0], node.px[1] + t * d[1]);
        let (light, dark) = (level(x + side[0], y + side[1]), level(x - side[0], y - side[1]));
        matches!((light, dark), (Some(light), Some(dark)) if light - dark > least)
    })
}
