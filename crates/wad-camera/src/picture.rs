//! Pictures for display: overlays on a frame, insets, contact sheets, PNG files.

use super::frame::Frame;
use super::model::ObjectClass;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// An RGB picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// sRGB bytes, row by row.
    pub rgb: Vec<u8>,
}

/// CARLA's colours of its semantic tags, by number.
const TAG_COLOURS: [[u8; 3]; 29] = [
    [0, 0, 0],
    [128, 64, 128],
    [244, 35, 232],
    [70, 70, 70],
    [102, 102, 156],
    [190, 153, 153],
    [153, 153, 153],
    [250, 170, 30],
    [220, 220, 0],
    [107, 142, 35],
    [152, 251, 152],
    [70, 130, 180],
    [220, 20, 60],
    [255, 0, 0],
    [0, 0, 142],
    [0, 0, 70],
    [0, 60, 100],
    [0, 80, 100],
    [0, 0, 230],
    [119, 11, 32],
    [110, 190, 160],
    [170, 120, 50],
    [55, 90, 80],
    [45, 60, 150],
    [157, 234, 50],
    [81, 0, 81],
    [150, 100, 100],
    [230, 150, 140],
    [180, 165, 180],
];

impl Picture {
    /// A black one.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, rgb: vec![0; width * height * 3] }
    }

    /// A frame's picture.
    pub fn rgb(frame: &Frame) -> Self {
        Self { width: frame.width, height: frame.height, rgb: frame.rgb.clone() }
    }

    fn of(frame: &Frame, pixel: impl Fn(usize) -> [u8; 3]) -> Self {
        let rgb = (0..frame.width * frame.height).flat_map(pixel).collect();
        Self { width: frame.width, height: frame.height, rgb }
    }

    /// A frame's depth: bright near, dark far, on a logarithmic scale from 1 to 200 m.
    pub fn depth(frame: &Frame) -> Self {
        Self::of(frame, |i| {
            let z = frame.depth.get(i).copied().unwrap_or(f32::INFINITY).clamp(1.0, 200.0);
            [(255.0 * (1.0 - z.ln() / 200.0_f32.ln())) as u8; 3]
        })
    }

    /// A frame's semantic tags in CARLA's colours.
    pub fn semantic(frame: &Frame) -> Self {
        Self::of(frame, |i| {
            let tag = frame.semantic.get(i).copied().unwrap_or_default();
            TAG_COLOURS.get(usize::from(tag)).copied().unwrap_or_default()
        })
    }

    /// A frame's instances, each in a colour of its own.
    pub fn instances(frame: &Frame) -> Self {
        Self::of(frame, |i| match frame.instance.get(i).copied().unwrap_or_default() {
            0 => [0; 3],
            id => {
                let [r, g, b, _] = super::simd::hash(id).to_le_bytes();
                [r | 64, g | 64, b | 64]
            }
        })
    }

    /// A frame's picture with the boxes round its objects' visible pixels.
    pub fn boxes(frame: &Frame) -> Self {
        let mut picture = Self::rgb(frame);
        for object in &frame.objects {
            let colour = match object.class {
                ObjectClass::Car => [60, 170, 255],
                ObjectClass::Truck | ObjectClass::Bus => [255, 120, 40],
                ObjectClass::Person => [255, 60, 90],
                ObjectClass::Motorcycle | ObjectClass::Bicycle => [220, 80, 255],
                ObjectClass::TrafficLight => [255, 230, 40],
                ObjectClass::Bench => [120, 255, 140],
            };
            let [x0, y0, x1, y1] = object.visible_box.map(|v| v as usize);
            picture.outline([x0, y0, x1.max(1) - 1, y1.max(1) - 1], colour);
        }
        picture
    }

    /// Draws a box (left, top, right, bottom in pixels, right and bottom exclusive).
    pub fn frame(&mut self, bounds: [f32; 4], colour: [u8; 3]) {
        let [x0, y0, x1, y1] = bounds.map(|v| v.max(0.0).round() as usize);
        self.outline([x0, y0, x1.max(x0 + 1) - 1, y1.max(y0 + 1) - 1], colour);
    }

    /// A thin box; left, top, right, bottom inclusive. Cut at the picture's borders.
    pub fn outline(&mut self, [x0, y0, x1, y1]: [usize; 4], colour: [u8; 3]) {
        for x in x0..=x1 {
            self.set(x, y0, colour);
            self.set(x, y1, colour);
        }
        for y in y0..=y1 {
            self.set(x0, y, colour);
            self.set(x1, y, colour);
        }
    }

    /// Colours a pixel; does nothing outside the picture.
    pub fn set(&mut self, x: usize, y: usize, colour: [u8; 3]) {
        if x < self.width && y < self.height {
            let at = 3 * (y * self.width + x);
            self.rgb[at..at + 3].copy_from_slice(&colour);
        }
    }

    /// The picture in another size: the mean of the pixels that fall together, or the nearest.
    #[must_use]
    pub fn scaled(&self, width: usize, height: usize) -> Self {
        let mut out = Self::new(width, height);
        let range = |i: usize, to: usize, from: usize| {
            let first = i * from / to;
            (first, ((i + 1) * from / to).max(first + 1))
        };
        for y in 0..height {
            let (y0, y1) = range(y, height, self.height);
            for x in 0..width {
                let (x0, x1) = range(x, width, self.width);
                let mut sum = [0_u32; 3];
                for yy in y0..y1 {
                    for xx in x0..x1 {
                        let at = 3 * (yy * self.width + xx);
                        for (sum, value) in sum.iter_mut().zip(&self.rgb[at..at + 3]) {
                            *sum += u32::from(*value);
                        }
                    }
                }
                let count = ((y1 - y0) * (x1 - x0)) as u32;
                out.set(x, y, sum.map(|s| (s / count) as u8));
            }
        }
        out
    }

    /// Puts another picture on this one, its upper left corner at (x, y).
    pub fn paste(&mut self, other: &Self, x: usize, y: usize) {
        for row in 0..other.height.min(self.height.saturating_sub(y)) {
            let count = 3 * other.width.min(self.width.saturating_sub(x));
            let to = 3 * ((y + row) * self.width + x);
            let from = 3 * row * other.width;
            self.rgb[to..to + count].copy_from_slice(&other.rgb[from..from + count]);
        }
    }

    /// As a mirror shows it: left and right swapped.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        let rows = self.rgb.chunks_exact(3 * self.width);
        let rgb = rows.flat_map(|row| row.rchunks_exact(3).flatten().copied()).collect();
        Self { rgb, ..*self }
    }

    /// Puts another picture on this one with a light frame round it.
    pub fn inset(&mut self, other: &Self, x: usize, y: usize) {
        self.paste(other, x, y);
        if x > 0 && y > 0 {
            self.outline([x - 1, y - 1, x + other.width, y + other.height], [235; 3]);
        }
    }

    /// Writes letters and digits of capital height 5 `scale` pixels, light on a dark ground.
    pub fn label(&mut self, text: &str, x: usize, y: usize, scale: usize) {
        let (width, height) = (4 * scale * text.len() + scale, 7 * scale);
        for yy in y..y + height {
            for xx in x..x + width {
                self.set(xx, yy, [20; 3]);
            }
        }
        for (n, letter) in text.chars().enumerate() {
            let glyph = match letter.to_ascii_uppercase() {
                letter @ 'A'..='Z' => LETTERS[(letter as u8 - b'A') as usize],
                digit @ '0'..='9' => DIGITS[(digit as u8 - b'0') as usize],
                _ => continue,
            };
            for bit in 0..15 {
                if glyph >> (14 - bit) & 1 == 1 {
                    for k in 0..scale * scale {
                        let at = (x + scale + 4 * scale * n + bit % 3 * scale, y + scale + bit / 3 * scale);
                        self.set(at.0 + k % scale, at.1 + k / scale, [240; 3]);
                    }
                }
            }
        }
    }

    /// Checks that [`Picture::save`] can write there: makes the folder, and does not change an existing file.
    ///
    /// # Errors
    /// The name ends neither in .png nor in .jpg, or the file cannot be written.
    pub fn can_save(path: &Path) -> io::Result<()> {
        let kind = extension(path);
        if path.is_dir() || !matches!(kind.as_deref(), Some("png" | "jpg" | "jpeg")) {
            let why = "not the name of a picture: expected a file that ends in .png or .jpg";
            return Err(io::Error::new(io::ErrorKind::InvalidInput, why));
        }
        make_folder(path)?;
        let is_new = !path.exists();
        std::fs::OpenOptions::new().append(true).create(true).open(path)?;
        if is_new { std::fs::remove_file(path) } else { Ok(()) }
    }

    /// Writes a PNG file, or a JPEG file where the name ends in .jpg or .jpeg.
    ///
    /// # Errors
    /// The file cannot be written, or the picture is too large for JPEG.
    pub fn save(&self, path: &Path) -> io::Result<()> {
        make_folder(path)?;
        if matches!(extension(path).as_deref(), Some("jpg" | "jpeg")) {
            return std::fs::write(path, self.jpeg()?);
        }
        let mut file = BufWriter::new(std::fs::File::create(path)?);
        self.write_png(&mut file)?;
        file.flush()
    }

    /// The bytes of a PNG file.
    ///
    /// # Errors
    /// Width, height and pixels do not fit.
    pub fn png(&self) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.write_png(&mut bytes)?;
        Ok(bytes)
    }

    fn write_png(&self, to: impl io::Write) -> io::Result<()> {
        let mut encoder = png::Encoder::new(to, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.rgb)?;
        Ok(writer.finish()?)
    }

    /// The bytes of a JPEG file.
    ///
    /// # Errors
    /// A side is longer than JPEG's 65,535 pixels, or the pixels do not fit.
    pub fn jpeg(&self) -> io::Result<Vec<u8>> {
        let side = |pixels: usize| {
            u16::try_from(pixels).map_err(|_| {
                let why =
                    format!("a JPEG file holds at most 65535 pixels a side, found {pixels}: write a .png");
                io::Error::new(io::ErrorKind::InvalidInput, why)
            })
        };
        let (width, height) = (side(self.width)?, side(self.height)?);
        let mut bytes = Vec::new();
        jpeg_encoder::Encoder::new(&mut bytes, JPEG_QUALITY)
            .encode(&self.rgb, width, height, jpeg_encoder::ColorType::Rgb)
            .map_err(io::Error::other)?;
        Ok(bytes)
    }
}

/// Quality of JPEG files, 0 to 100.
const JPEG_QUALITY: u8 = 85;

/// What the name ends in, in small letters.
fn extension(path: &Path) -> Option<String> {
    path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase())
}

/// Makes the folder that a file belongs in.
fn make_folder(path: &Path) -> io::Result<()> {
    path.parent().filter(|p| !p.as_os_str().is_empty()).map_or(Ok(()), std::fs::create_dir_all)
}

/// Digits, 3 x 5 pixels, rows from the top.
const DIGITS: [u16; 10] = [
    0b111_101_101_101_111,
    0b010_110_010_010_111,
    0b111_001_111_100_111,
    0b111_001_111_001_111,
    0b101_101_111_001_001,
    0b111_100_111_001_111,
    0b111_100_111_101_111,
    0b111_001_010_010_010,
    0b111_101_111_101_111,
    0b111_101_111_001_111,
];

/// Capital letters, 3 x 5 pixels, rows from the top.
const LETTERS: [u16; 26] = [
    0b010_101_111_101_101,
    0b110_101_110_101_110,
    0b011_100_100_100_011,
    0b110_101_101_101_110,
    0b111_100_110_100_111,
    0b111_100_110_100_100,
    0b011_100_101_101_011,
    0b101_101_111_101_101,
    0b111_010_010_010_111,
    0b001_001_001_101_010,
    0b101_101_110_101_101,
    0b100_100_100_100_111,
    0b101_111_111_101_101,
    0b110_101_101_101_101,
    0b010_101_101_101_010,
    0b110_101_110_100_100,
    0b010_101_101_111_011,
    0b110_101_110_101_101,
    0b011_100_010_001_110,
    0b111_010_010_010_010,
    0b101_101_101_101_111,
    0b101_101_101_101_010,
    0b101_101_111_111_101,
    0b101_101_010_101_101,
    0b101_101_010_010_010,
    0b111_001_010_100_111,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_saved_picture_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/p.png");
        let mut picture = Picture::new(5, 3);
        picture.set(4, 2, [9, 8, 7]);
        picture.save(&path).unwrap();
        let mut reader = png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path).unwrap()))
            .read_info()
            .unwrap();
        let mut bytes = vec![0; 45];
        reader.next_frame(&mut bytes).unwrap();
        assert_eq!(bytes, picture.rgb);
    }

    #[test]
    fn a_place_that_cannot_hold_a_picture_is_known_before() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/p.png");
        Picture::can_save(&path).unwrap();
        assert!(path.parent().unwrap().is_dir() && !path.exists());
        std::fs::write(&path, "mine").unwrap();
        Picture::can_save(&path).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"mine");
        for wrong in ["p.bmp", "p", "new", "new/p.png/q.png"] {
            assert!(Picture::can_save(&folder.path().join(wrong)).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_mirror_swaps_left_and_right() {
        let mut picture = Picture::new(3, 2);
        picture.set(0, 1, [9, 8, 7]);
        let mut swapped = Picture::new(3, 2);
        swapped.set(2, 1, [9, 8, 7]);
        assert_eq!(picture.mirrored(), swapped);
    }

    #[test]
    fn pasting_over_the_border_is_cut() {
        let mut picture = Picture::new(4, 4);
        let mut other = Picture::new(3, 3);
        other.rgb.fill(200);
        picture.paste(&other, 2, 3);
        assert_eq!(picture.rgb.iter().filter(|&&v| v == 200).count(), 2 * 3);
        assert_eq!(other.scaled(6, 1).rgb, vec![200; 18]);
    }
}
