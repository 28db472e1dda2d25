//! Boxes in boxes around the triangles: what a ray meets first.

use glam::DVec3;

use super::model::Model;

/// Faces in a box that is not divided further.
const FEW: usize = 4;

/// A face that a ray meets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// How far along the ray, in lengths of its direction.
    pub distance: f64,
    /// The face.
    pub face: usize,
    /// The weights of the face's second and third corner at the place.
    pub weights: [f64; 2],
}

/// The faces of a model in an order that a ray can search.
pub struct Tree {
    boxes: Vec<Node>,
    /// Numbers of faces, those of a box next to each other.
    order: Vec<u32>,
    /// In that order: a corner and the edges to the two others.
    triangles: Vec<[DVec3; 3]>,
}

struct Node {
    least: DVec3,
    most: DVec3,
    first: u32,
    /// How many faces it holds itself; 0 where two boxes follow, the next one and the one at `first`.
    count: u32,
}

impl Tree {
    /// Sorts the faces: half of them to each side of the middle one along the longest extent of their centres.
    pub fn new(model: &Model) -> Self {
        let mut order: Vec<u32> = (0..model.faces.len() as u32).collect();
        let centres: Vec<DVec3> =
            (0..model.faces.len()).map(|face| model.corners(face).iter().sum::<DVec3>() / 3.0).collect();
        let mut boxes = vec![];
        divide(&mut boxes, (&mut order, 0), &centres, model);
        let triangles = order.iter().map(|&face| {
            let [a, b, c] = model.corners(face as usize);
            [a, b - a, c - a]
        });
        Self { boxes, triangles: triangles.collect(), order }
    }

    /// The nearest face before `most` lengths of `direction` from `origin`, whichever side it shows.
    pub fn hit(&self, origin: DVec3, direction: DVec3, most: f64) -> Option<Hit> {
        let inverse = direction.recip();
        // Each box halves what is in it: there are never more than the depth of the tree.
        let (mut waiting, mut count, mut most, mut found) = ([0u32; 64], 1, most, None);
        while count > 0 {
            count -= 1;
            let at = waiting[count];
            let node = &self.boxes[at as usize];
            if !node.is_met(origin, inverse, most) {
                continue;
            }
            if node.count == 0 {
                waiting[count..count + 2].copy_from_slice(&[node.first, at + 1]);
                count += 2;
                continue;
            }
            for i in node.first as usize..(node.first + node.count) as usize {
                if let Some((distance, weights)) = meet(&self.triangles[i], origin, direction)
                    && distance < most
                {
                    most = distance;
                    found = Some(Hit { distance, face: self.order[i] as usize, weights });
                }
            }
        }
        found
    }
}

fn divide(boxes: &mut Vec<Node>, (order, first): (&mut [u32], usize), centres: &[DVec3], model: &Model) {
    let corners = || order.iter().flat_map(|&face| model.corners(face as usize));
    // A flat box has an extent all the same.
    let margin = DVec3::splat(1e-9);
    let least = corners().fold(DVec3::INFINITY, DVec3::min) - margin;
    let most = corners().fold(DVec3::NEG_INFINITY, DVec3::max) + margin;
    let at = boxes.len();
    boxes.push(Node { least, most, first: first as u32, count: order.len() as u32 });
    if order.len() <= FEW {
        return;
    }
    let own = || order.iter().map(|&face| centres[face as usize]);
    let extent = own().fold(DVec3::NEG_INFINITY, DVec3::max) - own().fold(DVec3::INFINITY, DVec3::min);
    let axis = extent.max_position();
    let middle = order.len() / 2;
    order.select_nth_unstable_by(middle, |&a, &b| {
        centres[a as usize][axis].total_cmp(&centres[b as usize][axis])
    });
    let (left, right) = order.split_at_mut(middle);
    divide(boxes, (left, first), centres, model);
    (boxes[at].first, boxes[at].count) = (boxes.len() as u32, 0);
    divide(boxes, (right, first + middle), centres, model);
}

impl Node {
    fn is_met(&self, origin: DVec3, inverse: DVec3, most: f64) -> bool {
        let (a, b) = ((self.least - origin) * inverse, (self.most - origin) * inverse);
        // Where the ray runs along a side, 0 times infinity: such a side does not bound it.
        let low = |x: f64, y: f64| {
            if x < y {
                x
            } else if y <= x {
                y
            } else {
                f64::NEG_INFINITY
            }
        };
        let high = |x: f64, y: f64| {
            if x > y {
                x
            } else if y >= x {
                y
            } else {
                f64::INFINITY
            }
        };
        let near = low(a.x, b.x).max(low(a.y, b.y)).max(low(a.z, b.z)).max(0.0);
        let far = high(a.x, b.x).min(high(a.y, b.y)).min(high(a.z, b.z)).min(most);
        near <= far * (1.0 + 1e-12)
    }
}

/// Möller and Trumbore (1997), with edges a little wider than they are: nothing slips between two faces.
fn meet([corner, one, other]: &[DVec3; 3], origin: DVec3, direction: DVec3) -> Option<(f64, [f64; 2])> {
    const EDGE: f64 = 1e-9;
    let across = direction.cross(*other);
    let volume = one.dot(across);
    if volume == 0.0 {
        return None;
    }
    let from = origin - *corner;
    let u = from.dot(across) / volume;
    let over = from.cross(*one);
    let v = direction.dot(over) / volume;
    if u < -EDGE || v < -EDGE || u + v > 1.0 + EDGE {
        return None;
    }
    let distance = other.dot(over) / volume;
    (distance > 0.0).then_some((distance, [u, v]))
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::*;

    #[test]
    fn the_nearest_face_is_the_one_that_trying_all_of_them_finds() {
        let mut random = rand::rngs::StdRng::seed_from_u64(3);
        let mut point = |by: f64| DVec3::from_array(std::array::from_fn(|_| random.random_range(-by..by)));
        let points_m: Vec<DVec3> = (0..300)
            .flat_map(|_| {
                let at = point(3.0);
                [at, at + point(0.7), at + point(0.7)]
            })
            .collect();
        let faces = (0..300).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let model = Model { points_m, faces, uv: vec![], notes: vec![] };
        let tree = Tree::new(&model);
        let mut hits = 0;
        for i in 0..500 {
            // Also along the axes.
            let direction = if i < 6 { [DVec3::X, DVec3::Y, DVec3::Z][i % 3] } else { point(1.0) };
            let origin = point(1.0);
            let all = (0..300).filter_map(|face| {
                let [a, b, c] = model.corners(face);
                meet(&[a, b - a, c - a], origin, direction).map(|(distance, _)| (distance, face))
            });
            let expected = all.min_by(|a, b| a.0.total_cmp(&b.0));
            let found = tree.hit(origin, direction, f64::INFINITY);
            assert_eq!(found.map(|hit| (hit.distance, hit.face)), expected);
            if let Some(hit) = found {
                hits += 1;
                let [a, b, c] = model.corners(hit.face);
                let [u, v] = hit.weights;
                let place = a + u * (b - a) + v * (c - a);
                assert!(place.distance(origin + hit.distance * direction) < 1e-9);
                assert!(tree.hit(origin, direction, hit.distance).is_none());
            }
        }
        assert!(hits > 100);
    }
}
