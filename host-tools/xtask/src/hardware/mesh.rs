//! Solids of axis-aligned boxes, as closed meshes in STL files.

use std::collections::BTreeSet;

/// Box from its lowest to its highest corner, in mm.
pub type Block = [[f64; 3]; 2];

/// Face of a cell: its corners, counter-clockwise from outside, in hundredths of a millimetre.
pub type Face = [[i64; 3]; 4];

/// Hundredths of a millimetre.
fn hundredths(mm: f64) -> i64 {
    (100.0 * mm).round() as i64
}

/// Solid that begins empty; blocks are added and cut away in turn.
#[derive(Clone, Debug, Default)]
pub struct Solid {
    steps: Vec<(bool, [[i64; 3]; 2])>,
}

impl Solid {
    /// Adds a block.
    #[must_use]
    pub fn add(mut self, block: Block) -> Self {
        self.steps.push((true, block.map(|corner| corner.map(hundredths))));
        self
    }

    /// Cuts a block away.
    #[must_use]
    pub fn cut(mut self, block: Block) -> Self {
        self.steps.push((false, block.map(|corner| corner.map(hundredths))));
        self
    }

    /// Whether a point is inside.
    fn holds(&self, point: [i64; 3]) -> bool {
        let within =
            |[low, high]: &[[i64; 3]; 2]| (0..3).all(|i| low[i] <= point[i] && point[i] < high[i]);
        self.steps.iter().rev().find(|(_, block)| within(block)).is_some_and(|(added, _)| *added)
    }

    /// Faces between inside and outside, cut along all planes of the blocks.
    ///
    /// Every face is whole between two neighbouring planes, so that corners meet corners. Cells
    /// follow each other from the back to the front, from the left and from below, so that a
    /// picture may be drawn in this order.
    #[must_use]
    pub fn faces(&self) -> Vec<Face> {
        let planes: [Vec<i64>; 3] = std::array::from_fn(|axis| {
            let of = self.steps.iter().flat_map(|(_, block)| block.map(|corner| corner[axis]));
            of.collect::<BTreeSet<_>>().into_iter().collect()
        });
        let mut faces = Vec::new();
        let cells = |axis: usize| 0..planes[axis].len().saturating_sub(1);
        for y in cells(1).rev() {
            for x in cells(0) {
                for z in cells(2) {
                    let at = [x, y, z];
                    let low: [i64; 3] = std::array::from_fn(|i| planes[i][at[i]]);
                    let high: [i64; 3] = std::array::from_fn(|i| planes[i][at[i] + 1]);
                    if !self.holds(low) {
                        continue;
                    }
                    for axis in 0..3 {
                        let mut before = low;
                        before[axis] -= 1;
                        let mut after = low;
                        after[axis] = high[axis];
                        if !self.holds(before) {
                            faces.push(face(low, high, axis, false));
                        }
                        if !self.holds(after) {
                            faces.push(face(low, high, axis, true));
                        }
                    }
                }
            }
        }
        faces
    }

    /// Mesh as a binary STL file in mm.
    #[must_use]
    pub fn stl(&self, name: &str) -> Vec<u8> {
        let triangles = triangles(&self.faces());
        let mut out = format!("{name:<80.80}").into_bytes();
        out.extend((triangles.len() as u32).to_le_bytes());
        for corners in triangles {
            let normal = normal(&corners);
            for vector in [normal].into_iter().chain(corners.map(|c| c.map(|v| v as f64 / 100.0))) {
                vector.iter().for_each(|v| out.extend((*v as f32).to_le_bytes()));
            }
            out.extend([0, 0]);
        }
        out
    }
}

/// Face of a cell across `axis`, at its low or its high side.
fn face(low: [i64; 3], high: [i64; 3], axis: usize, at_high: bool) -> Face {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let corner = |along_u: bool, along_v: bool| {
        let mut corner = low;
        corner[axis] = if at_high { high[axis] } else { low[axis] };
        corner[u] = if along_u { high[u] } else { low[u] };
        corner[v] = if along_v { high[v] } else { low[v] };
        corner
    };
    let face = [corner(false, false), corner(true, false), corner(true, true), corner(false, true)];
    if at_high { face } else { [face[0], face[3], face[2], face[1]] }
}

/// Two triangles for each face.
fn triangles(faces: &[Face]) -> Vec<[[i64; 3]; 3]> {
    faces.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect()
}

/// Unit vector out of a triangle.
fn normal([a, b, c]: &[[i64; 3]; 3]) -> [f64; 3] {
    let [u, v] = [b, c].map(|p| std::array::from_fn::<f64, 3, _>(|i| (p[i] - a[i]) as f64));
    let cross: [f64; 3] = std::array::from_fn(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        u[j] * v[k] - u[k] * v[j]
    });
    let length = cross.iter().map(|x| x * x).sum::<f64>().sqrt();
    cross.map(|x| x / length)
}

/// Draws solids from above and in front, each with its place, as SVG.
#[must_use]
pub fn picture(solids: &[(&str, Solid, [f64; 3])]) -> String {
    use std::fmt::Write as _;
    // Parallel projection: x to the right, y to the back, z up.
    let project = |[x, y, z]: [f64; 3]| [0.9 * x + 0.45 * y, -0.5 * z - 0.62 * y + 0.12 * x];
    let mut drawn = Vec::new();
    let mut names = Vec::new();
    for (name, solid, place) in solids {
        let moved = |corner: [i64; 3]| {
            std::array::from_fn::<f64, 3, _>(|i| corner[i] as f64 / 100.0 + place[i])
        };
        let faces = solid.faces();
        let highest = faces.iter().map(|face| face[0][2]).max().unwrap_or(1);
        let widest = faces.iter().flatten().map(|corner| corner[0]).max().unwrap_or(0);
        for face in faces {
            let [x, y, z] = normal(&[face[0], face[1], face[2]]);
            // Higher is lighter.
            let grey = 150 + 90 * face[0][2] / highest;
            let fill = match (x > 0.5, y < -0.5, z > 0.5) {
                (true, ..) => "#5f6f86".to_owned(),
                (_, true, _) => "#8090a4".to_owned(),
                (.., true) => format!("#{grey:02x}{grey:02x}{:02x}", grey + 8),
                _ => continue,
            };
            let corners = face.map(moved);
            drawn.push((corners.map(project), fill));
        }
        // Right of the solid, whose right edge leans back.
        let beside = f64::max(17.0, 1.6 * widest as f64 / 100.0 - 7.0);
        names.push((*name, project([place[0] + beside, place[1], place[2]])));
    }
    let all = drawn.iter().flat_map(|(corners, _)| corners);
    let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
    for corner in all {
        for i in 0..2 {
            low[i] = low[i].min(corner[i]);
            high[i] = high[i].max(corner[i]);
        }
    }
    let scale = 10.0;
    let place = |[x, y]: [f64; 2]| (scale * (x - low[0]) + 10.0, scale * (y - low[1]) + 10.0);
    let (width, height) = (scale * (high[0] - low[0]) + 260.0, scale * (high[1] - low[1]) + 20.0);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"Helvetica, Arial, \
         sans-serif\" font-size=\"16\">\n<rect width=\"{width:.0}\" height=\"{height:.0}\" fill=\"white\"/>\n"
    );
    for (corners, fill) in drawn {
        let points: Vec<_> =
            corners.iter().map(|c| place(*c)).map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
        let _ =
            writeln!(out, "<path d=\"M{}Z\" fill=\"{fill}\" stroke=\"{fill}\"/>", points.join("L"));
    }
    for (name, at) in names {
        let (x, y) = place(at);
        let _ = writeln!(out, "<text x=\"{x:.0}\" y=\"{y:.0}\">{name}</text>");
    }
    out + "</svg>\n"
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// Triangles of a binary STL file, in hundredths of a millimetre, with their normals.
    fn read(stl: &[u8]) -> Vec<([[i64; 3]; 3], [f64; 3])> {
        let count = u32::from_le_bytes(stl[80..84].try_into().unwrap()) as usize;
        assert_eq!(stl.len(), 84 + 50 * count);
        let float = |at: usize| f64::from(f32::from_le_bytes(stl[at..at + 4].try_into().unwrap()));
        let vector = |at: usize| std::array::from_fn::<f64, 3, _>(|i| float(at + 4 * i));
        let triangle = |i: usize| {
            let at = 84 + 50 * i;
            let corners =
                std::array::from_fn(|corner| vector(at + 12 + 12 * corner).map(hundredths));
            (corners, vector(at))
        };
        (0..count).map(triangle).collect()
    }

    /// Volume in mm³ of a mesh; fails where it is not closed or not oriented.
    pub fn volume(stl: &[u8]) -> f64 {
        let triangles = read(stl);
        let mut edges = BTreeSet::new();
        for (corners, written) in &triangles {
            for i in 0..3 {
                let edge = (corners[i], corners[(i + 1) % 3]);
                assert!(
                    edge.0 != edge.1 && edges.insert(edge),
                    "edge {edge:?} twice: not oriented"
                );
            }
            assert!((0..3).all(|i| (normal(corners)[i] - written[i]).abs() < 1e-6));
        }
        for (a, b) in &edges {
            assert!(edges.contains(&(*b, *a)), "edge {a:?} {b:?} has one side: not closed");
        }
        let six = |[a, b, c]: &[[i64; 3]; 3]| {
            let [a, b, c] = [a, b, c].map(|p| p.map(|v| v as f64 / 100.0));
            (0..3)
                .map(|i| a[i] * (b[(i + 1) % 3] * c[(i + 2) % 3] - b[(i + 2) % 3] * c[(i + 1) % 3]))
                .sum::<f64>()
        };
        triangles.iter().map(|(corners, _)| six(corners)).sum::<f64>() / 6.0
    }

    #[test]
    fn solid_with_a_hole_is_closed_and_has_its_volume() {
        let plate = Solid::default().add([[0.0; 3], [10.0, 8.0, 2.0]]);
        assert!((volume(&plate.stl("plate")) - 160.0).abs() < 1e-9);
        let holed =
            plate.cut([[2.0, 2.0, -1.0], [4.0, 5.0, 3.0]]).cut([[6.0, 6.0, 1.0], [7.0, 7.0, 9.0]]);
        assert!((volume(&holed.stl("holed")) - 160.0 + 12.0 + 1.0).abs() < 1e-9);
    }

    #[test]
    #[should_panic(expected = "not closed")]
    fn mesh_without_a_triangle_is_not_closed() {
        let mut stl = Solid::default().add([[0.0; 3], [1.0; 3]]).stl("cube");
        stl.truncate(stl.len() - 50);
        stl[80] -= 1;
        let _ = volume(&stl);
    }
}
