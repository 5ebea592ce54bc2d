//! Triangles as a wall: flat patches, the edges between them, their corners.

use super::Foot;
use glam::DVec3;
use std::collections::HashMap;
use std::fmt;

/// Two triangles with a common edge are one patch when they are flat to this angle [rad]: single precision in a file of
/// triangles a hundred times as long as high leaves so much.
const FLAT: f64 = 1e-5;
/// Tests on boundaries between parts are this soft, in terms of the extent of the mesh: a foot on a boundary is found
/// on both sides rather than on none, and counted once.
const SOFT: f64 = 1e-11;
/// Triangles in a leaf of the tree.
const LEAF: usize = 4;
/// No edge or corner: inside a patch.
const INNER: u32 = u32::MAX;

/// A surface of triangles. Its parts are numbered: patches, edges, corners.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    faces: Vec<Triangle>,
    patches: Vec<Patch>,
    edges: Vec<Edge>,
    corners: Vec<Corner>,
    tree: Vec<Node>,
    /// The triangles in the order of the leaves.
    order: Vec<u32>,
    centre: DVec3,
    extent: f64,
}

#[derive(Clone, Debug, PartialEq)]
struct Triangle {
    corner: [DVec3; 3],
    /// Unit vectors in the plane of the patch, across the edges from corner `k` to the next, inwards.
    inward: [DVec3; 3],
    patch: u32,
    /// Numbers among the edges and corners of the mesh, or [`INNER`].
    edge: [u32; 3],
    end: [u32; 3],
}

/// Triangles in one plane that hang together by edges.
#[derive(Clone, Debug, PartialEq)]
struct Patch {
    point: DVec3,
    normal: DVec3,
}

/// An edge that is no inner one of a patch.
#[derive(Clone, Debug, PartialEq)]
struct Edge {
    from: DVec3,
    along: DVec3,
    length: f64,
    /// Into each triangle that ends here, across the edge.
    into: Vec<DVec3>,
}

/// A corner with such an edge.
#[derive(Clone, Debug, PartialEq)]
struct Corner {
    point: DVec3,
    /// Along all edges of triangles that begin here.
    arms: Vec<DVec3>,
}

/// A box around triangles: a leaf with some of them, or two more boxes.
#[derive(Clone, Debug, PartialEq)]
struct Node {
    lower: DVec3,
    upper: DVec3,
    /// Of a leaf, where its triangles begin in the order; of others, the first of the two.
    first: u32,
    /// Of a leaf, how many triangles it has; of others 0.
    count: u32,
}

/// Triangles that make no surface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MeshError {
    /// There is none.
    Empty,
    /// The corners of a triangle, counted from 0, are on one line.
    Flat(usize),
}

impl fmt::Display for MeshError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            MeshError::Empty => f.write_str("there is no triangle"),
            MeshError::Flat(k) => write!(f, "triangle {} has no area: its corners are on one line", k + 1),
        }
    }
}

impl std::error::Error for MeshError {}

impl Mesh {
    /// A surface of triangles, each with its three corners [m]. Triangles hang together where corners are the same to the
    /// last bit.
    ///
    /// # Errors
    /// When there is no triangle, or one without area.
    pub fn new(triangles: &[[DVec3; 3]]) -> Result<Self, MeshError> {
        if triangles.is_empty() {
            return Err(MeshError::Empty);
        }
        let (points, index) = weld(triangles);
        let mut normals = Vec::with_capacity(index.len());
        for (k, [a, b, c]) in triangles.iter().enumerate() {
            let (normal, longest) = (
                (*b - *a).cross(*c - *a),
                (*b - *a).length().max((*c - *b).length()).max((*a - *c).length()),
            );
            if normal.length() <= 1e-9 * longest * longest {
                return Err(MeshError::Flat(k));
            }
            normals.push(normal);
        }
        // Which triangles meet at which edge, in order of the triangles.
        let mut around: HashMap<[u32; 2], usize> = HashMap::new();
        let mut meet: Vec<([u32; 2], Vec<u32>)> = Vec::new();
        for (t, triangle) in index.iter().enumerate() {
            for k in 0..3 {
                let key = sorted(triangle[k], triangle[(k + 1) % 3]);
                let at = *around.entry(key).or_insert_with(|| {
                    meet.push((key, Vec::new()));
                    meet.len() - 1
                });
                meet[at].1.push(t as u32);
            }
        }
        let inner = |(key, at): &([u32; 2], Vec<u32>)| -> bool {
            let [t, u] = at[..] else { return false };
            let along = (points[key[1] as usize] - points[key[0] as usize]).normalize();
            let into = |t: u32| {
                let third = index[t as usize].iter().find(|c| !key.contains(c)).copied().unwrap_or(key[0]);
                let x = points[third as usize] - points[key[0] as usize];
                (x - x.dot(along) * along).normalize()
            };
            (into(t) + into(u)).length() < FLAT
        };
        let is_inner: Vec<bool> = meet.iter().map(inner).collect();
        let patch_of = gather(index.len(), meet.iter().zip(&is_inner).filter(|m| *m.1).map(|m| &m.0.1));
        let mut mesh = Mesh {
            patches: patches(triangles, &normals, &patch_of),
            faces: Vec::new(),
            edges: Vec::new(),
            corners: Vec::new(),
            tree: Vec::new(),
            order: (0..index.len() as u32).collect(),
            centre: DVec3::ZERO,
            extent: 0.0,
        };
        for (t, &corner) in triangles.iter().enumerate() {
            let (patch, [a, b, c]) = (patch_of[t], corner);
            let normal = mesh.patches[patch as usize].normal;
            let turn = normals[t].dot(normal).signum();
            let inward = [b - a, c - b, a - c].map(|side| turn * normal.cross(side).normalize());
            mesh.faces.push(Triangle { corner, inward, patch, edge: [INNER; 3], end: [INNER; 3] });
        }
        mesh.bound(&points, &index, &meet, &is_inner);
        let (lower, upper) = around_all(&points);
        mesh.centre = 0.5 * (lower + upper);
        mesh.extent = points.iter().map(|x| x.distance(mesh.centre)).fold(0.0, f64::max);
        mesh.plant(0, index.len());
        Ok(mesh)
    }

    /// A parallelogram with the corners `corner`, `corner + a`, `corner + b`.
    ///
    /// # Errors
    /// When it has no area.
    pub fn rectangle(corner: DVec3, a: DVec3, b: DVec3) -> Result<Self, MeshError> {
        Mesh::new(&quad([corner, corner + a, corner + a + b, corner + b]))
    }

    /// The surface of a box.
    ///
    /// # Errors
    /// When a side has no area.
    pub fn cuboid(lower: DVec3, upper: DVec3) -> Result<Self, MeshError> {
        let at = |k: usize| {
            let pick = |axis: usize| if k >> axis & 1 == 0 { lower[axis] } else { upper[axis] };
            DVec3::new(pick(0), pick(1), pick(2))
        };
        let sides = [[0, 2, 6, 4], [1, 3, 7, 5], [0, 1, 5, 4], [2, 3, 7, 6], [0, 1, 3, 2], [4, 5, 7, 6]];
        let triangles: Vec<_> = sides.iter().flat_map(|side| quad(side.map(at))).collect();
        Mesh::new(&triangles)
    }

    /// Finds the edges and corners that bound patches.
    fn bound(
        &mut self,
        points: &[DVec3],
        index: &[[u32; 3]],
        meet: &[([u32; 2], Vec<u32>)],
        is_inner: &[bool],
    ) {
        let mut arms: Vec<Vec<DVec3>> = vec![Vec::new(); points.len()];
        let mut corner_of = vec![INNER; points.len()];
        for ((key, at), _) in meet.iter().zip(is_inner).filter(|m| !*m.1) {
            let [a, b] = key.map(|k| points[k as usize]);
            let mut into = Vec::new();
            for &t in at {
                let triangle = index[t as usize];
                for k in (0..3).filter(|&k| sorted(triangle[k], triangle[(k + 1) % 3]) == *key) {
                    self.faces[t as usize].edge[k] = self.edges.len() as u32;
                    into.push(self.faces[t as usize].inward[k]);
                }
            }
            let along = (b - a).normalize();
            self.edges.push(Edge { from: a, along, length: (b - a).length(), into });
            key.iter().for_each(|&k| corner_of[k as usize] = 0);
        }
        for (key, _) in meet {
            let along = (points[key[1] as usize] - points[key[0] as usize]).normalize();
            arms[key[0] as usize].push(along);
            arms[key[1] as usize].push(-along);
        }
        for (k, arms) in
            arms.into_iter().enumerate().filter(|(k, _)| corner_of[*k] != INNER).collect::<Vec<_>>()
        {
            corner_of[k] = self.corners.len() as u32;
            self.corners.push(Corner { point: points[k], arms });
        }
        for (face, triangle) in self.faces.iter_mut().zip(index) {
            face.end = triangle.map(|k| corner_of[k as usize]);
        }
    }

    /// Makes the box around the triangles `start..end` of the order, and those inside it.
    fn plant(&mut self, start: usize, end: usize) {
        let root = self.tree.len();
        self.tree.push(self.leaf(start, end));
        let mut open = vec![(root, start, end)];
        while let Some((node, start, end)) = open.pop() {
            if end - start <= LEAF {
                continue;
            }
            let faces = &self.faces;
            let middle = |t: u32| faces[t as usize].corner.iter().sum::<DVec3>();
            let size = self.tree[node].upper - self.tree[node].lower;
            let axis = if size.x >= size.y.max(size.z) {
                0
            } else if size.y >= size.z {
                1
            } else {
                2
            };
            let half = start + (end - start) / 2;
            self.order[start..end]
                .sort_unstable_by(|&a, &b| middle(a)[axis].total_cmp(&middle(b)[axis]).then(a.cmp(&b)));
            let first = self.tree.len();
            let two = [self.leaf(start, half), self.leaf(half, end)];
            self.tree.extend(two);
            (self.tree[node].first, self.tree[node].count) = (first as u32, 0);
            open.extend([(first, start, half), (first + 1, half, end)]);
        }
    }

    fn leaf(&self, start: usize, end: usize) -> Node {
        let corners = self.order[start..end].iter().flat_map(|&t| self.faces[t as usize].corner);
        let (lower, upper) = around_all(&corners.collect::<Vec<_>>());
        Node { lower, upper, first: start as u32, count: (end - start) as u32 }
    }

    /// Number of its parts.
    pub fn parts(&self) -> u32 {
        (self.patches.len() + self.edges.len() + self.corners.len()) as u32
    }

    /// Number of flat patches, of edges between or around them, and of corners.
    pub fn census(&self) -> [usize; 3] {
        [self.patches.len(), self.edges.len(), self.corners.len()]
    }

    /// The middle of the box around it [m].
    pub fn centre(&self) -> DVec3 {
        self.centre
    }

    /// Distance of its furthest corner from its centre [m].
    pub fn extent(&self) -> f64 {
        self.extent
    }

    /// Area along the normal [m²] of a mesh that is one flat patch.
    pub fn area(&self) -> Option<DVec3> {
        let [patch] = &self.patches[..] else { return None };
        let twice = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).dot(patch.normal).abs();
        Some(0.5 * self.triangles().map(twice).sum::<f64>() * patch.normal)
    }

    /// Its triangles.
    pub fn triangles(&self) -> impl Iterator<Item = [DVec3; 3]> + '_ {
        self.faces.iter().map(|face| face.corner)
    }

    /// Appends the triangles within `reach` of a centre, some a little further off too; returns whether there are any.
    pub fn near(&self, centre: DVec3, reach: f64, triangles: &mut Vec<u32>) -> bool {
        let before = triangles.len();
        let mut open = [0_u32; 64];
        let mut left = 1;
        while left > 0 {
            left -= 1;
            let node = &self.tree[open[left] as usize];
            let apart = (node.lower - centre).max(centre - node.upper).max(DVec3::ZERO);
            if apart.length_squared() > reach * reach {
                continue;
            }
            if node.count == 0 {
                (open[left], open[left + 1]) = (node.first, node.first + 1);
                left += 2;
                continue;
            }
            let leaf = &self.order[node.first as usize..][..node.count as usize];
            triangles.extend(leaf.iter().filter(|&&t| {
                let face = &self.faces[t as usize];
                let patch = &self.patches[face.patch as usize];
                let out = (0..3).map(|k| (face.corner[k] - centre).dot(face.inward[k])).fold(0.0, f64::max);
                out.max((centre - patch.point).dot(patch.normal).abs()) <= reach
            }));
        }
        triangles[before..].sort_unstable();
        triangles.len() > before
    }

    /// Appends the parts on which a grain has a foot; `triangles` are those near it.
    pub fn feet(&self, centre: DVec3, triangles: &[u32], found: &mut Vec<u32>) {
        let (first, soft) = (found.len(), SOFT * self.extent);
        let (edges, corners) = (self.patches.len() as u32, (self.patches.len() + self.edges.len()) as u32);
        for &t in triangles {
            let face = &self.faces[t as usize];
            if (0..3).all(|k| (centre - face.corner[k]).dot(face.inward[k]) >= -soft) {
                found.push(face.patch);
                continue;
            }
            for k in 0..3 {
                if let Some(edge) = self.edges.get(face.edge[k] as usize) {
                    let x = centre - edge.from;
                    let along = x.dot(edge.along);
                    if -soft <= along
                        && along <= edge.length + soft
                        && edge.into.iter().all(|&into| x.dot(into) <= soft)
                    {
                        found.push(edges + face.edge[k]);
                    }
                }
                if let Some(corner) = self.corners.get(face.end[k] as usize) {
                    let x = centre - corner.point;
                    if corner.arms.iter().all(|&arm| x.dot(arm) <= soft) {
                        found.push(corners + face.end[k]);
                    }
                }
            }
        }
        if found.len() - first < 2 {
            return;
        }
        found[first..].sort_unstable();
        // One foot on the boundary of two parts belongs to the first of them.
        let mut kept = first;
        for k in first..found.len() {
            let branch = self.foot(found[k], centre).branch;
            let apart = |&part: &u32| self.foot(part, centre).branch.distance(branch) > 8.0 * soft;
            if found[first..kept].iter().all(apart) {
                found[kept] = found[k];
                kept += 1;
            }
        }
        found.truncate(kept);
    }

    /// The foot on a part, for which the part is taken to have no end.
    pub fn foot(&self, part: u32, centre: DVec3) -> Foot {
        let part = part as usize;
        if let Some(patch) = self.patches.get(part) {
            return Foot {
                branch: -(centre - patch.point).dot(patch.normal) * patch.normal,
                normal: -patch.normal,
            };
        }
        let part = part - self.patches.len();
        if let Some(edge) = self.edges.get(part) {
            let x = centre - edge.from;
            return Foot {
                branch: x.dot(edge.along) * edge.along - x,
                normal: edge.along.any_orthonormal_vector(),
            };
        }
        Foot { branch: self.corners[part - self.edges.len()].point - centre, normal: DVec3::X }
    }
}

fn quad([a, b, c, d]: [DVec3; 4]) -> [[DVec3; 3]; 2] {
    [[a, b, c], [a, c, d]]
}

fn sorted(a: u32, b: u32) -> [u32; 2] {
    if a < b { [a, b] } else { [b, a] }
}

fn around_all(points: &[DVec3]) -> (DVec3, DVec3) {
    let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    points.iter().fold(start, |(lower, upper), x| (lower.min(*x), upper.max(*x)))
}

/// The different corners of triangles, and the triangles in their numbers.
fn weld(triangles: &[[DVec3; 3]]) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut known: HashMap<[u64; 3], u32> = HashMap::new();
    let mut points = Vec::new();
    let mut number = |x: DVec3| {
        // Of zero there are two.
        *known.entry((x + DVec3::ZERO).to_array().map(f64::to_bits)).or_insert_with(|| {
            points.push(x);
            points.len() as u32 - 1
        })
    };
    let index = triangles.iter().map(|corners| corners.map(&mut number)).collect();
    (points, index)
}

/// The number of the group each of `n` is in, groups counted in order of their first, when all of each list go together.
fn gather<'a>(n: usize, together: impl Iterator<Item = &'a Vec<u32>>) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..n as u32).collect();
    fn root(parent: &mut [u32], mut k: u32) -> u32 {
        while parent[k as usize] != k {
            parent[k as usize] = parent[parent[k as usize] as usize];
            k = parent[k as usize];
        }
        k
    }
    for list in together {
        for pair in list.windows(2) {
            let (a, b) = (root(&mut parent, pair[0]), root(&mut parent, pair[1]));
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    let mut groups = 0;
    let mut number = vec![0; n];
    for k in 0..n as u32 {
        let first = root(&mut parent, k);
        if first == k {
            number[k as usize] = groups;
            groups += 1;
        } else {
            number[k as usize] = number[first as usize];
        }
    }
    number
}

/// The plane of each patch: the mean of its triangles, by area; `normals` are twice the areas.
fn patches(triangles: &[[DVec3; 3]], normals: &[DVec3], patch_of: &[u32]) -> Vec<Patch> {
    let count = patch_of.iter().max().map_or(0, |&last| last as usize + 1);
    let mut sums = vec![(0.0, DVec3::ZERO, DVec3::ZERO); count];
    for ((corner, &normal), &patch) in triangles.iter().zip(normals).zip(patch_of) {
        let (area, point, sum) = &mut sums[patch as usize];
        // Neighbours in a file may be wound either way.
        *sum += if normal.dot(*sum) < 0.0 { -normal } else { normal };
        *area += normal.length();
        *point += normal.length() * corner.iter().sum::<DVec3>() / 3.0;
    }
    sums.iter()
        .map(|(area, point, normal)| Patch { point: *point / *area, normal: normal.normalize() })
        .collect()
}
