//! What a glTF document refers to: buffers and pictures, within the file, in data URIs, or in files beside it.

use crate::render::objects::material::Texture;
use ::gltf::{Document, buffer, texture};
use base64::Engine;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use recordings::codec::image::PictureHeader;
use recordings::types::{Response, RgbImage};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Component, Path};
use std::sync::Arc;

/// Bytes that all buffers and pictures may have together.
const MAX_BYTES: u64 = 1 << 30;
/// Pixels that all textures may have together (four of 4096 × 4096), 12 bytes each.
const MAX_TEXTURE_PIXELS: u64 = 1 << 26;

const BASE64: GeneralPurpose = GeneralPurpose::new(
    &base64::alphabet::STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// Reads resources until a limit of bytes.
pub struct Resources<'a> {
    folder: &'a Path,
    bytes_left: u64,
}

impl<'a> Resources<'a> {
    /// Files are looked for in `folder`.
    pub fn new(folder: &'a Path) -> Self {
        Self { folder, bytes_left: MAX_BYTES }
    }

    /// The bytes of every buffer; `blob` is the binary chunk of a `.glb`.
    pub fn buffers(&mut self, document: &Document, mut blob: Option<Vec<u8>>) -> Result<Vec<Vec<u8>>, String> {
        let read = |buffer: ::gltf::Buffer| {
            let data = match buffer.source() {
                buffer::Source::Uri(uri) => self.read(uri)?,
                buffer::Source::Bin => blob.take().ok_or("a buffer has no data")?,
            };
            if data.len() < buffer.length() {
                return Err("a buffer is shorter than its byteLength: the file is truncated".into());
            }
            Ok(data)
        };
        document.buffers().map(read).collect()
    }

    fn read(&mut self, uri: &str) -> Result<Vec<u8>, String> {
        if let Some(data) = uri.strip_prefix("data:") {
            let (_, text) = data.split_once(";base64,").ok_or("a data URI is not base64")?;
            self.take(text.len() as u64 / 4 * 3)?;
            return BASE64.decode(text).map_err(|e| format!("a data URI is not base64: {e}"));
        }
        let name = uri.replace("%20", " ");
        if !Path::new(&name).components().all(|c| matches!(c, Component::Normal(_))) {
            return Err(format!("it refers to `{uri}`, outside its own folder"));
        }
        let unreadable = |e: std::io::Error| format!("it refers to `{uri}`, which cannot be read: {e}");
        let file = std::fs::File::open(self.folder.join(&name)).map_err(unreadable)?;
        let length = file.metadata().map_err(unreadable)?.len();
        self.take(length)?;
        let mut bytes = Vec::new();
        file.take(length).read_to_end(&mut bytes).map_err(unreadable)?;
        Ok(bytes)
    }

    fn take(&mut self, bytes: u64) -> Result<(), String> {
        self.bytes_left = self.bytes_left.checked_sub(bytes).ok_or("it refers to more than 1 GiB; simplify it")?;
        Ok(())
    }
}

/// Decodes textures, each picture once.
pub struct Textures<'a> {
    document: &'a Document,
    buffers: &'a [Vec<u8>],
    resources: Resources<'a>,
    pixels_left: u64,
    decoded: BTreeMap<(usize, bool), Arc<Texture>>,
}

impl<'a> Textures<'a> {
    /// Of a document with its buffers.
    pub fn new(document: &'a Document, buffers: &'a [Vec<u8>], resources: Resources<'a>) -> Self {
        Self { document, buffers, resources, pixels_left: MAX_TEXTURE_PIXELS, decoded: BTreeMap::new() }
    }

    /// The texture a material refers to, whose values have the given `response`.
    pub fn get(&mut self, info: Option<texture::Info<'_>>, response: Response) -> Result<Option<Arc<Texture>>, String> {
        let Some(info) = info else { return Ok(None) };
        let key = (info.texture().source().index(), response == Response::Linear);
        if let Some(known) = self.decoded.get(&key) {
            return Ok(Some(Arc::clone(known)));
        }
        let texture = self.decode(key.0, response).map_err(|e| format!("a texture cannot be read: {e}"))?;
        self.decoded.insert(key, Arc::clone(&texture));
        Ok(Some(texture))
    }

    fn decode(&mut self, image: usize, response: Response) -> Result<Arc<Texture>, String> {
        let root = self.document.as_json();
        let image = root.images.get(image).ok_or("the picture is missing")?;
        let loaded;
        let bytes = match (&image.uri, image.buffer_view) {
            (Some(uri), _) => {
                loaded = self.resources.read(uri)?;
                &loaded
            }
            (None, Some(view)) => {
                let view = self.document.views().nth(view.value()).ok_or("its buffer view is missing")?;
                view_bytes(&view, self.buffers).ok_or("its buffer view goes beyond the buffer")?
            }
            (None, None) => return Err("the picture has neither URI nor buffer view".into()),
        };
        let header = PictureHeader::read(bytes)?;
        let pixels = u64::from(header.width) * u64::from(header.height);
        self.pixels_left = self.pixels_left.checked_sub(pixels).ok_or("the textures are too large; scale them down")?;
        Ok(Arc::new(Texture::new(&RgbImage::decode(bytes)?, &response.linear_table())))
    }
}

/// The bytes of a buffer view; `None` where it goes beyond its buffer.
pub fn view_bytes<'a>(view: &buffer::View<'_>, buffers: &'a [Vec<u8>]) -> Option<&'a [u8]> {
    let end = view.offset().checked_add(view.length())?;
    buffers.get(view.buffer().index())?.get(view.offset()..end)
}
