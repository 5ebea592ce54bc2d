//! Files that ParaView opens: `.vtp` for grains, `.vtu` for pores, `.pvd` for the series in time.
//!
//! XML with the arrays appended as raw little-endian bytes, each preceded by its length in 8 bytes
//! (VTK file formats, "appended" and "raw").

use glam::DVec3;
use std::fmt::Write as _;

/// One array of a file.
pub enum Values<'a> {
    /// One number per entry.
    Scalars(&'a [f64]),
    /// One vector per entry.
    Vectors(&'a [DVec3]),
    /// A symmetric tensor per entry, as xx, yy, zz, xy, yz, xz.
    Tensors(&'a [[f64; 6]]),
    /// One whole number per entry.
    Integers(&'a [u32]),
}

/// A named array.
pub struct Field<'a> {
    /// Name, with the unit in brackets.
    pub name: &'a str,
    /// One entry per point or cell.
    pub values: Values<'a>,
}

/// Shapes of cells; the numbers are VTK's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// 4 corners.
    Tetrahedron = 10,
    /// 8 corners.
    Hexahedron = 12,
    /// 6 corners.
    Wedge = 13,
}

/// Pores as a mesh with numbers on it.
#[derive(Clone, Debug, Default)]
pub struct PoreMesh {
    /// Corners [m].
    pub points: Vec<DVec3>,
    /// Shape of each cell.
    pub shapes: Vec<Shape>,
    /// Corners of all cells, one cell after the other, in VTK's order.
    pub corners: Vec<u32>,
    /// Numbers on each cell, by name.
    pub scalars: Vec<(String, Vec<f64>)>,
    /// Vectors on each cell, by name.
    pub vectors: Vec<(String, Vec<DVec3>)>,
}

/// The bytes of a `.vtp` file with one vertex per point.
pub fn points(position: &[DVec3], fields: &[Field]) -> Vec<u8> {
    let n = position.len();
    let mut file = Appended::default();
    let mut xml = String::from(HEAD_POLY);
    let _ = writeln!(
        xml,
        "<PolyData>\n<Piece NumberOfPoints=\"{n}\" NumberOfVerts=\"{n}\" NumberOfLines=\"0\" NumberOfStrips=\"0\" \
         NumberOfPolys=\"0\">"
    );
    xml.push_str("<PointData>\n");
    for field in fields {
        file.field(&mut xml, field);
    }
    xml.push_str("</PointData>\n<Points>\n");
    file.field(&mut xml, &Field { name: "position", values: Values::Vectors(position) });
    xml.push_str("</Points>\n<Verts>\n");
    file.integers(&mut xml, "connectivity", 0..n as i64);
    file.integers(&mut xml, "offsets", 1..n as i64 + 1);
    xml.push_str("</Verts>\n</Piece>\n</PolyData>\n");
    file.finish(xml)
}

/// What the cells of a surface or a network are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cells {
    /// Flat polygons.
    Polygons,
    /// Lines.
    Lines,
}

/// The bytes of a `.vtp` file with triangles, and fields on them.
pub fn surface(triangles: &[[DVec3; 3]], fields: &[Field]) -> Vec<u8> {
    cells(Cells::Polygons, triangles.as_flattened(), (0..triangles.len()).map(|k| 3 * k + 3), fields)
}

/// The bytes of a `.vtp` file with cells that have their corners one after the other in `points`, each up to an `end`, and
/// fields on them.
pub fn cells(
    kind: Cells,
    points: &[DVec3],
    ends: impl ExactSizeIterator<Item = usize>,
    fields: &[Field],
) -> Vec<u8> {
    let (lines, polygons) = match kind {
        Cells::Lines => (ends.len(), 0),
        Cells::Polygons => (0, ends.len()),
    };
    let mut file = Appended::default();
    let mut xml = String::from(HEAD_POLY);
    let _ = writeln!(
        xml,
        "<PolyData>\n<Piece NumberOfPoints=\"{}\" NumberOfVerts=\"0\" NumberOfLines=\"{lines}\" NumberOfStrips=\"0\" \
         NumberOfPolys=\"{polygons}\">\n<CellData>",
        points.len()
    );
    for field in fields {
        file.field(&mut xml, field);
    }
    xml.push_str("</CellData>\n<Points>\n");
    file.field(&mut xml, &Field { name: "position", values: Values::Vectors(points) });
    let element = match kind {
        Cells::Lines => "Lines",
        Cells::Polygons => "Polys",
    };
    let _ = writeln!(xml, "</Points>\n<{element}>");
    file.integers(&mut xml, "connectivity", 0..points.len() as i64);
    file.integers(&mut xml, "offsets", ends.map(|end| end as i64));
    let _ = writeln!(xml, "</{element}>\n</Piece>\n</PolyData>");
    file.finish(xml)
}

/// The bytes of a `.vtu` file.
pub fn mesh(pores: &PoreMesh) -> Vec<u8> {
    let mut file = Appended::default();
    let mut xml = String::from(HEAD_MESH);
    let _ = writeln!(
        xml,
        "<UnstructuredGrid>\n<Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\">",
        pores.points.len(),
        pores.shapes.len()
    );
    xml.push_str("<CellData>\n");
    for (name, values) in &pores.scalars {
        file.field(&mut xml, &Field { name, values: Values::Scalars(values) });
    }
    for (name, values) in &pores.vectors {
        file.field(&mut xml, &Field { name, values: Values::Vectors(values) });
    }
    xml.push_str("</CellData>\n<Points>\n");
    file.field(&mut xml, &Field { name: "position", values: Values::Vectors(&pores.points) });
    xml.push_str("</Points>\n<Cells>\n");
    file.integers(&mut xml, "connectivity", pores.corners.iter().map(|&k| k.into()));
    let mut end = 0;
    file.integers(
        &mut xml,
        "offsets",
        pores.shapes.iter().map(|shape| {
            end += shape.corners();
            end
        }),
    );
    let shapes: Vec<u8> = pores.shapes.iter().map(|&s| s as u8).collect();
    file.array(&mut xml, "UInt8", "types", 1, &shapes);
    xml.push_str("</Cells>\n</Piece>\n</UnstructuredGrid>\n");
    file.finish(xml)
}

/// The text of a `.pvd` file: the files of a series and their times [s].
pub fn series<'a>(files: impl IntoIterator<Item = (f64, &'a str)>) -> String {
    let mut xml = String::from(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\">\n\
         <Collection>\n",
    );
    for (time, file) in files {
        let _ = writeln!(xml, "<DataSet timestep=\"{time}\" part=\"0\" file=\"{file}\"/>");
    }
    xml.push_str("</Collection>\n</VTKFile>\n");
    xml
}

const HEAD_POLY: &str = "<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\" version=\"1.0\" \
    byte_order=\"LittleEndian\" header_type=\"UInt64\">\n";
const HEAD_MESH: &str = "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" \
    byte_order=\"LittleEndian\" header_type=\"UInt64\">\n";

impl Shape {
    fn corners(self) -> i64 {
        match self {
            Shape::Tetrahedron => 4,
            Shape::Hexahedron => 8,
            Shape::Wedge => 6,
        }
    }
}

/// The raw bytes that follow the XML.
#[derive(Default)]
struct Appended {
    bytes: Vec<u8>,
}

impl Appended {
    fn array(&mut self, xml: &mut String, kind: &str, name: &str, components: usize, bytes: &[u8]) {
        let _ = writeln!(
            xml,
            "<DataArray type=\"{kind}\" Name=\"{}\" NumberOfComponents=\"{components}\" format=\"appended\" \
             offset=\"{}\"/>",
            escaped(name),
            self.bytes.len()
        );
        self.bytes.extend((bytes.len() as u64).to_le_bytes());
        self.bytes.extend(bytes);
    }

    fn integers(&mut self, xml: &mut String, name: &str, values: impl Iterator<Item = i64>) {
        let bytes: Vec<u8> = values.flat_map(i64::to_le_bytes).collect();
        self.array(xml, "Int64", name, 1, &bytes);
    }

    fn field(&mut self, xml: &mut String, field: &Field) {
        let (kind, components, bytes): (_, _, Vec<u8>) = match field.values {
            Values::Scalars(values) => ("Float64", 1, values.iter().flat_map(|x| x.to_le_bytes()).collect()),
            Values::Vectors(values) => {
                ("Float64", 3, values.iter().flat_map(|v| v.to_array()).flat_map(f64::to_le_bytes).collect())
            }
            Values::Tensors(values) => {
                ("Float64", 6, values.iter().flatten().flat_map(|x| x.to_le_bytes()).collect())
            }
            Values::Integers(values) => ("UInt32", 1, values.iter().flat_map(|x| x.to_le_bytes()).collect()),
        };
        self.array(xml, kind, field.name, components, &bytes);
    }

    fn finish(self, mut xml: String) -> Vec<u8> {
        xml.push_str("<AppendedData encoding=\"raw\">\n_");
        let mut file = xml.into_bytes();
        file.extend(self.bytes);
        file.extend(b"\n</AppendedData>\n</VTKFile>\n");
        file
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}
