//! Reading and writing of result files.

use crate::codec::chunk::{ChunkReader, ChunkWriter, Tag};
use crate::codec::connectivity::{self, Traversal};
use crate::codec::header::{from_bytes, to_bytes};
use crate::codec::vertices;
use crate::decision::{Cut, Decision, DecisionText, Warning};
use crate::error::{Error, Result};
use crate::local_light::LocalLight;
use crate::result::estimate::Estimate;
use crate::result::origin::Origin;
use crate::result::texture::Texture;
use crate::types::Mesh;
use crate::v1::{DecisionV1, EstimateV1, LightV1};
use std::path::Path;

/// Kind of file.
pub const KIND: Tag = *b"LRES";
const VERSION: u32 = 1;
const HEAD: Tag = *b"HEAD";
const LIGHT: Tag = *b"LIGH";
const TRIANGLES: Tag = *b"TRIA";
const VERTICES: Tag = *b"VERT";
/// Costs of the decisions: programs that do not know it skip it.
const COSTS: Tag = *b"COST";
/// Decisions, cuts and warnings as figures. Programs that do not know it, or a variant in it, read the sentences in the head.
const FINDINGS: Tag = *b"FIND";
/// Lamps and emission; absent where the light is distant. Programs that do not know it show the distant part alone.
const LOCAL_LIGHT: Tag = *b"NEAR";
/// Albedo at the resolution of the photographs; absent where it was not made. Programs that do not know it show the vertices.
const TEXTURE: Tag = *b"TEXT";
/// What the result was made from. Programs that do not know it skip it.
const ORIGIN: Tag = *b"ORIG";
const KNOWN: &[(Tag, u32)] = &[
    (HEAD, 1 << 26),
    (LIGHT, 1 << 24),
    (TRIANGLES, 1 << 30),
    (VERTICES, 1 << 30),
    (COSTS, 1 << 20),
    (FINDINGS, 1 << 20),
    (LOCAL_LIGHT, 1 << 26),
    (TEXTURE, 1 << 28),
];
/// What the chunk of findings holds.
type Findings = (Vec<Decision>, Vec<Cut>, Vec<Warning>);
impl Estimate {
    /// Reads a result file.
    ///
    /// # Errors
    /// Unreadable, damaged, no result, or of a newer version.
    pub fn read(path: &Path) -> Result<Self> {
        let mut file = ChunkReader::open(path, KIND, VERSION, KNOWN)?;
        let invalid = |problem: String| Error::invalid(path, problem, "estimate it again");
        let mut chunks: [Option<Vec<u8>>; 8] = Default::default();
        let mut payload = Vec::new();
        while let Some(tag) = file.next(&mut payload)? {
            if let Some(slot) = KNOWN.iter().position(|(known, _)| *known == tag) {
                chunks[slot] = Some(std::mem::take(&mut payload));
            }
        }
        let [Some(head), Some(light), Some(triangles), Some(vertices), costs, findings, local, texture] = chunks else {
            return Err(invalid("a part is missing".into()));
        };
        let mut estimate =
            Self::from_chunks(&head, &light, &triangles, &vertices, costs.as_deref()).map_err(invalid)?;
        // Of a newer program's model the distant part is left.
        if let Some((local, _)) = local.as_deref().and_then(|l| from_bytes::<LocalLight>(l).ok()) {
            local.check(estimate.mesh.positions.len()).map_err(invalid)?;
            estimate.local_light = local;
        }
        if let Some(texture) = texture {
            let texture = Texture::unpack(&texture).map_err(invalid)?;
            texture.check(estimate.mesh.triangles.len()).map_err(invalid)?;
            estimate.texture = Some(texture);
        }
        // A variant of a newer program leaves the sentences in place.
        if let Some((findings, _)) = findings.as_deref().and_then(|f| from_bytes::<Findings>(f).ok()) {
            (estimate.decisions, estimate.cuts, estimate.warnings) = findings;
        }
        Ok(estimate)
    }

    fn from_chunks(
        head: &[u8],
        light: &[u8],
        triangles: &[u8],
        vertices: &[u8],
        costs: Option<&[u8]>,
    ) -> std::result::Result<Self, String> {
        let (head, _) = from_bytes::<EstimateV1>(head)?;
        let costs = costs.map_or(Ok(Vec::new()), |c| from_bytes::<Vec<String>>(c).map(|(costs, _)| costs))?;
        let costs = costs.into_iter().chain(std::iter::repeat(String::new()));
        let (light, _) = from_bytes::<LightV1>(light)?;
        let (triangles, order) = vertices::unpack_triangles(triangles)?;
        let vertices = vertices::unpack(vertices, &order)?;
        let estimate = Self {
            name: head.name,
            response: head.response.try_into()?,
            mesh: Mesh { positions: vertices.positions, normals: vertices.normals, triangles },
            segment: vertices.segment,
            lit_color: vertices.lit_color,
            albedo: vertices.albedo,
            confidence: vertices.confidence,
            light: light.into(),
            segments: head.segments.into_iter().map(Into::into).collect(),
            keyframes: head.keyframes.into_iter().map(TryInto::try_into).collect::<std::result::Result<_, _>>()?,
            transfer: head.transfer.parse()?,
            decisions: head
                .decisions
                .into_iter()
                .zip(costs)
                .map(|(d, cost)| Decision::Text(d.with_cost(cost)))
                .collect(),
            cuts: head.cuts.into_iter().map(Cut::Text).collect(),
            warnings: head.warnings.into_iter().map(Warning::Text).collect(),
            albedo_scale_rule: head.albedo_scale_rule,
            witnesses: head.witnesses.into_iter().map(Into::into).collect(),
            local_light: LocalLight::default(),
            texture: None,
        };
        estimate.check()?;
        Ok(estimate)
    }

    /// Writes a result file, quantised (by fsync and rename). Vertices keep their order, triangles do not.
    ///
    /// # Errors
    /// The disk is full or gone; a number is not finite, an index out of range, or arrays differ in length.
    pub fn write(&self, path: &Path) -> Result<()> {
        self.write_from(path, None)
    }

    /// Writes a result file that tells what it was made from.
    ///
    /// # Errors
    /// As [`Estimate::write`].
    pub fn write_from(&self, path: &Path, origin: Option<&Origin>) -> Result<()> {
        self.written(path, origin)?.finish()
    }

    /// The same without the wait for the disk: after a power cut the file may be damaged, which reading it tells.
    ///
    /// # Errors
    /// As [`Estimate::write`].
    pub fn write_unsynced(&self, path: &Path, origin: Option<&Origin>) -> Result<()> {
        self.written(path, origin)?.finish_unsynced()
    }

    fn written(&self, path: &Path, origin: Option<&Origin>) -> Result<ChunkWriter> {
        let refuse = |problem: String| Error::invalid(path, problem, "this result cannot be stored");
        self.check().map_err(refuse)?;
        let texts: Vec<DecisionText> = self.decisions.iter().map(Decision::text).collect();
        let head = EstimateV1 {
            name: self.name.clone(),
            response: self.response.into(),
            segments: self.segments.iter().map(Into::into).collect(),
            keyframes: self.keyframes.iter().map(Into::into).collect(),
            transfer: self.transfer.to_string(),
            decisions: texts.iter().map(DecisionV1::from).collect(),
            cuts: self.cuts.iter().map(ToString::to_string).collect(),
            warnings: self.warnings.iter().map(ToString::to_string).collect(),
            albedo_scale_rule: self.albedo_scale_rule.clone(),
            witnesses: self.witnesses.iter().map(Into::into).collect(),
        };
        let Traversal { codes, order, triangles } =
            connectivity::encode(&self.mesh.triangles, self.mesh.positions.len());
        let mut file = ChunkWriter::create(path, KIND, VERSION)?;
        file.write(HEAD, &[&to_bytes(&head).map_err(refuse)?])?;
        file.write(LIGHT, &[&to_bytes(&LightV1::from(&self.light)).map_err(refuse)?])?;
        file.write(TRIANGLES, &[&vertices::pack_triangles(&codes, self.mesh.triangles.len(), &order)])?;
        file.write(VERTICES, &[&vertices::pack(self, &order).map_err(refuse)?])?;
        let costs: Vec<&String> = texts.iter().map(|t| &t.cost).collect();
        file.write(COSTS, &[&to_bytes(&costs).map_err(refuse)?])?;
        file.write(FINDINGS, &[&to_bytes(&(&self.decisions, &self.cuts, &self.warnings)).map_err(refuse)?])?;
        if self.local_light != LocalLight::default() {
            file.write(LOCAL_LIGHT, &[&to_bytes(&self.local_light).map_err(refuse)?])?;
        }
        if let Some(origin) = origin {
            file.write(ORIGIN, &[&to_bytes(origin).map_err(refuse)?])?;
        }
        if let Some(texture) = &self.texture {
            file.write(TEXTURE, &[&texture.pack(&triangles).map_err(refuse)?])?;
        }
        Ok(file)
    }
}

impl Origin {
    /// Reads it from a result file, whose every chunk is checked; `None` in a result that does not tell.
    ///
    /// # Errors
    /// Unreadable, damaged, no result, or of a newer version.
    pub fn read(path: &Path) -> Result<Option<Self>> {
        let mut file = ChunkReader::open(path, KIND, VERSION, &[(ORIGIN, 1 << 16)])?;
        let (mut origin, mut payload) = (None, Vec::new());
        while file.next(&mut payload)?.is_some() {
            let read = from_bytes::<Self>(&payload);
            origin = Some(read.map_err(|problem| Error::invalid(path, problem, "estimate it again"))?.0);
        }
        Ok(origin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::estimate::Light;
    use crate::scan::contents::check_mesh;
    use crate::testing::{bumpy_mesh, estimate_on, refuses_damage, resealed};
    use glam::Vec3;
    use proptest::prelude::*;

    fn written(estimate: &Estimate) -> (tempfile::TempDir, std::path::PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lres");
        estimate.write(&path).unwrap();
        (dir, path)
    }

    /// Bytes a vertex: all, and those of connectivity.
    fn size(estimate: &Estimate) -> (f64, f64) {
        let (_dir, path) = written(estimate);
        let n = estimate.mesh.positions.len();
        let Traversal { codes, order, .. } = connectivity::encode(&estimate.mesh.triangles, n);
        let triangles = vertices::pack_triangles(&codes, estimate.mesh.triangles.len(), &order).len();
        (std::fs::metadata(&path).unwrap().len() as f64 / n as f64, triangles as f64 / n as f64)
    }

    #[test]
    fn a_result_comes_back_as_exactly_as_it_is_quantised() {
        let estimate = estimate_on(bumpy_mesh(30));
        let (_dir, path) = written(&estimate);
        let read = Estimate::read(&path).unwrap();
        for v in 0..900 {
            assert!((read.mesh.positions[v] - estimate.mesh.positions[v]).length() < 2e-5);
            assert!(read.mesh.normals[v].dot(estimate.mesh.normals[v]) > 0.999_999);
            assert!(((read.lit_color[v] - estimate.lit_color[v]) / estimate.lit_color[v]).abs().max_element() < 5e-4);
            assert!(((read.albedo[v] - estimate.albedo[v]) / estimate.albedo[v]).abs().max_element() < 1.5e-3);
            assert!((read.confidence[v] - estimate.confidence[v]).abs() < 0.002);
        }
        assert_eq!(read.mesh.triangles.len(), estimate.mesh.triangles.len());
        let same = |e: &Estimate| Estimate {
            mesh: Mesh::default(),
            segment: e.segment.clone(),
            lit_color: vec![],
            albedo: vec![],
            confidence: vec![],
            ..e.clone()
        };
        assert_eq!(same(&read), same(&estimate));
        // Once quantised, nothing changes any more.
        let (_dir, again) = written(&read);
        assert_eq!(
            Estimate::read(&again).unwrap(),
            Estimate { mesh: Estimate::read(&again).unwrap().mesh, ..read.clone() }
        );
        assert_eq!(Estimate::read(&again).unwrap().mesh.positions, read.mesh.positions);
    }

    #[test]
    fn empty_and_tiny_results_come_back() {
        let mut empty = estimate_on(Mesh::default());
        empty.light = Light::default();
        empty.segments.clear();
        empty.keyframes.clear();
        let (_dir, path) = written(&empty);
        assert_eq!(Estimate::read(&path).unwrap(), empty);
        let one = Mesh { positions: vec![Vec3::ONE], normals: vec![], triangles: vec![[0; 3]] };
        let (_dir, path) = written(&estimate_on(one.clone()));
        assert_eq!(Estimate::read(&path).unwrap().mesh, one);
    }

    /// As a program of the next version may write it: a variant that this one does not know.
    #[test]
    fn findings_of_a_newer_program_are_read_as_sentences() {
        let estimate = estimate_on(bumpy_mesh(4));
        let (_dir, path) = written(&estimate);
        let mut bytes = std::fs::read(&path).unwrap();
        let payload = bytes.windows(4).position(|w| w == FINDINGS).unwrap() + 12;
        bytes = resealed(&bytes, payload + 1, 200);
        std::fs::write(&path, bytes).unwrap();
        let read = Estimate::read(&path).unwrap();
        let texts = |e: &Estimate| e.decisions.iter().map(Decision::text).collect::<Vec<_>>();
        assert_eq!(texts(&read), texts(&estimate));
        let cuts: Vec<Cut> = estimate.cuts.iter().map(|c| Cut::Text(c.to_string())).collect();
        let warnings: Vec<Warning> = estimate.warnings.iter().map(|w| Warning::Text(w.to_string())).collect();
        assert_eq!((read.cuts, read.warnings), (cuts, warnings));
    }

    #[test]
    fn damage_is_refused() {
        let (_dir, path) = written(&estimate_on(bumpy_mesh(12)));
        refuses_damage(&path, Estimate::read);
    }

    #[test]
    fn nonsense_is_not_written() {
        let good = estimate_on(bumpy_mesh(4));
        let dir = tempfile::tempdir().unwrap();
        let refused = |change: &dyn Fn(&mut Estimate)| {
            let mut bad = good.clone();
            change(&mut bad);
            bad.write(&dir.path().join("a.lres")).is_err() && std::fs::read_dir(dir.path()).unwrap().count() == 0
        };
        assert!(refused(&|e| e.segment[3] = 2));
        assert!(refused(&|e| e.albedo[3].x = f32::NAN));
        assert!(refused(&|e| e.confidence.truncate(3)));
        assert!(refused(&|e| e.light.coefficients.truncate(5)));
        assert!(refused(&|e| e.light.coefficients[5][1] = f64::INFINITY));
        assert!(refused(&|e| e.segments[0].w_s = f64::NAN));
        assert!(refused(&|e| e.keyframes[0].gain[0] = 0.0));
        assert!(refused(&|e| e.mesh.triangles[0][0] = 16));
    }

    #[test]
    fn shuffled_noisy_vertices_keep_the_size_bounds() {
        // The worst case: neighbours share nothing, in memory or in value.
        let n = 20_000u32;
        let hash = |i: u32, k: u32| {
            (i.wrapping_mul(2_654_435_761).wrapping_add(k * 0x9e37) ^ i >> 3).wrapping_mul(0x85eb_ca6b)
        };
        let unit = |i: u32, k: u32| (hash(i, k) >> 8) as f32 / (1u32 << 24) as f32;
        let vector = |i: u32, k: u32| Vec3::new(unit(i, k), unit(i, k + 1), unit(i, k + 2));
        let mut estimate = estimate_on(Mesh {
            positions: (0..n).map(|i| vector(i, 0)).collect(),
            normals: (0..n).map(|i| (vector(i, 3) - 0.5).normalize_or(Vec3::Z)).collect(),
            triangles: vec![],
        });
        estimate.lit_color = (0..n).map(|i| vector(i, 6)).collect();
        estimate.albedo = (0..n).map(|i| vector(i, 9)).collect();
        let (whole, connectivity) = size(&estimate);
        assert!(whole - connectivity <= 24.0, "{whole} with {connectivity} for connectivity");
    }

    #[test]
    fn a_mesh_shuffled_takes_hardly_more() {
        let mesh = bumpy_mesh(100);
        let n = 10_000u32;
        let shuffle = |i: u32| (i * 7919) % n;
        let mut shuffled = mesh.clone();
        for i in 0..n {
            shuffled.positions[shuffle(i) as usize] = mesh.positions[i as usize];
            shuffled.normals[shuffle(i) as usize] = mesh.normals[i as usize];
        }
        shuffled.triangles.iter_mut().flatten().for_each(|v| *v = shuffle(*v));
        let t = shuffled.triangles.len();
        shuffled.triangles = (0..t).map(|i| shuffled.triangles[i * 7919 % t]).collect();
        for mesh in [mesh, shuffled] {
            let (whole, connectivity) = size(&estimate_on(mesh));
            assert!(whole <= 36.0 && whole - connectivity <= 24.0, "{whole} with {connectivity} for connectivity");
            println!("{whole:.2} bytes a vertex, {connectivity:.2} of them connectivity");
        }
    }

    proptest! {
        #[test]
        fn nonsense_behind_a_right_checksum_never_panics(at in any::<usize>(), value in any::<u8>()) {
            static WHOLE: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
            let whole = WHOLE.get_or_init(|| {
                let dir = tempfile::tempdir().unwrap();
                let path = dir.path().join("a.lres");
                estimate_on(bumpy_mesh(6)).write(&path).unwrap();
                std::fs::read(path).unwrap()
            });
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("damaged");
            std::fs::write(&path, resealed(whole, at % whole.len(), value)).unwrap();
            if let Ok(read) = Estimate::read(&path) {
                prop_assert!(check_mesh(&read.mesh).is_ok());
            }
        }
    }
}
