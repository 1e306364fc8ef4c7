//! What `eyes` see beside objects, by heads of their own over the light backbone's features: the boundaries of the
//! ego's lane, row by row, the light that is the ego's, signs, and the drivable area.
//!
//! ```text
//! features at /4 --3x3--+--1x1-----------> the ego's signal heads by lamp, distance of the stop line
//! picture --1x1, largest of 4x4--3x3--+
//! features at /4 --/8, rows below the horizon--+--3x3, 1x1--> per row and side: the boundary's column, or none
//!                                              +--3x3, 1x1--> whether a cell is road
//! features at /4 --3x3--+--3x3, 1x1--> signs by what they say, their distance (rows round the horizon)
//! picture --3x3/2, 3x3/2, 3x3--+
//! ```
//!
//! A lamp 40 m away is one pixel, whose colour the backbone's strides blur: the light's head also sees the strongest of
//! some colours in each cell of the picture itself, and where in the picture the cell is (Liu et al. 2018, "CoordConv"):
//! which heads are the ego's depends on both. Digits are smaller than the backbone's cells, so the head for signs has
//! convolutions of its own over the picture; what it finds is [read](super::reader) from a picture of the plate alone.

use super::decode::{LIGHT, SIGN_CHANNELS, SIGN_ROWS};
use super::graph::{COLOURS, HIDDEN, MAP, SIGN_STEM, place};
use super::kind::{Learns, Part, STRIDE};
use super::layer::{Conv, Kernel};
use super::reader;
use crate::perception::area::ROWS;
use tch::nn::Path;
use tch::{Kind, TchError, Tensor};

/// Whole pictures have this many cells of features: width and height. Parts of pictures have no answers, for where the ego is in
/// them is not known.
pub(super) const WHOLE: [i64; 2] = [MAP[1] as i64, MAP[0] as i64];

/// The heads.
#[derive(Debug)]
pub struct RoadHeads {
    light_hidden: Conv,
    colours: Conv,
    light_colours: Conv,
    /// (1, 2, h, w): see [`place`].
    place: Tensor,
    light: Conv,
    hidden: Conv,
    lanes: Conv,
    /// Over the picture, then over the features, then over their sum.
    signs_pixels: [Conv; 3],
    signs_features: Conv,
    signs_hidden: Conv,
    signs: Conv,
    area_hidden: Conv,
    area: Conv,
    /// Over plates: see [`super::reader`].
    read: [Conv; 4],
}

/// Their output before softmax and sigmoid.
#[derive(Debug)]
pub struct RoadAnswer {
    /// (n, 4, h, w): see [`super::decode`].
    pub light: Tensor,
    /// (n, 2, 20, 65): left and right boundary, by rows from the horizon down: columns, then none.
    pub lanes: Tensor,
    /// (n, 14, 40, 128): see [`super::decode`].
    pub signs: Tensor,
    /// (n, 1, 20, 64): see [`super::decode`].
    pub area: Tensor,
}

impl RoadHeads {
    /// Over features of `channels` channels.
    ///
    /// # Errors
    /// torch fails.
    pub fn new(path: &Path<'_>, channels: i64) -> Result<Self, TchError> {
        let mut light = Conv::new(&(path / "light"), HIDDEN, LIGHT, Kernel::plain(1));
        light.begin_at(0.01, super::network::FIRST_ANSWER)?;
        let mut light_colours = Conv::new(&(path / "light_colours"), COLOURS + 2, HIDDEN, Kernel::plain(3));
        light_colours.begin_at(0.01, 0.0)?;
        let mut signs = Conv::new(&(path / "signs"), HIDDEN, SIGN_CHANNELS, Kernel::plain(1));
        signs.begin_at(0.01, super::network::FIRST_ANSWER)?;
        let [first, second, third, last] = reader::layers();
        let layer = |(name, [to, from, side, _]): (&str, [i64; 4])| {
            Conv::new(&(path / name), from, to, Kernel::plain(side))
        };
        let [w, h] = WHOLE;
        let place = Tensor::f_from_slice(&place())?.f_view([1, 2, h, w])?.f_to_device(path.device())?;
        Ok(Self {
            place,
            colours: Conv::new(&(path / "colours"), 3, COLOURS, Kernel::plain(1)),
            light_colours,
            light_hidden: Conv::new(&(path / "light_hidden"), channels, HIDDEN, Kernel::normed(3, 1)),
            light,
            hidden: Conv::new(&(path / "hidden"), channels, HIDDEN, Kernel::normed(3, 1)),
            lanes: Conv::new(&(path / "lanes"), HIDDEN, 4, Kernel::plain(1)),
            signs_pixels: [
                Conv::new(&(path / "signs_stem1"), 3, SIGN_STEM, Kernel::normed(3, 2)),
                Conv::new(&(path / "signs_stem2"), SIGN_STEM, HIDDEN, Kernel::normed(3, 2)),
                Conv::new(&(path / "signs_pixels"), HIDDEN, HIDDEN, Kernel::normed(3, 1)),
            ],
            signs_features: Conv::new(&(path / "signs_features"), channels, HIDDEN, Kernel::normed(3, 1)),
            signs_hidden: Conv::new(&(path / "signs_hidden"), HIDDEN, HIDDEN, Kernel::normed(3, 1)),
            signs,
            read: [layer(first), layer(second), layer(third), layer(last)],
            area_hidden: Conv::new(&(path / "area_hidden"), channels, HIDDEN, Kernel::normed(3, 1)),
            area: Conv::new(&(path / "area"), HIDDEN, 1, Kernel::plain(1)),
        })
    }

    /// What plates (n, 3, 24, 24) say (n, 14: signs, none), before the softmax.
    ///
    /// # Errors
    /// torch fails.
    pub fn read(&self, plates: &Tensor) -> Result<Tensor, TchError> {
        let [first, second, third, last] = &self.read;
        let looked = |conv: &Conv, x: &Tensor| {
            conv.forward(x, false)?.f_relu()?.f_max_pool2d([2, 2], [2, 2], [0, 0], [1, 1], false)
        };
        let x = looked(second, &looked(first, plates)?)?;
        let x = x.f_view([x.size()[0], -1, 1, 1])?;
        last.forward(&third.forward(&x, false)?.f_relu()?, false)?.f_view([-1, reader::ANSWERS as i64])
    }

    /// Features (n, channels, h, w) of whole pictures (n, 3, 4 h, 4 w); None for parts of pictures. `learns` says which
    /// heads learn.
    ///
    /// # Errors
    /// torch fails.
    pub fn forward(
        &self,
        x: &Tensor,
        pictures: &Tensor,
        learns: Learns,
    ) -> Result<Option<RoadAnswer>, TchError> {
        let train = learns.all();
        let size = x.size();
        if [size[3], size[2]] != WHOLE {
            return Ok(None);
        }
        let half = x.f_avg_pool2d([2, 2], [2, 2], [0, 0], false, true, None)?;
        let below = half.f_narrow(2, size[2] / 2 - ROWS as i64, ROWS as i64)?;
        let hidden = self.hidden.forward(&below, train)?.f_relu()?.f_to_kind(Kind::Float)?;
        let answers = self.lanes.forward(&hidden, train)?;
        let none = answers.f_narrow(1, 2, 2)?.f_mean_dim([3_i64].as_slice(), true, Kind::Float)?;
        let lanes = Tensor::f_cat(&[answers.f_narrow(1, 0, 2)?, none], 3)?;
        let colours = self.colours.forward(pictures, train)?.f_relu()?;
        let side = [STRIDE as i64; 2];
        let colours = colours.f_max_pool2d(side, side, [0, 0], [1, 1], false)?.f_to_kind(Kind::Float)?;
        let place = self.place.f_expand([size[0], -1, -1, -1], false)?;
        let beside = Tensor::f_cat(&[colours, place], 1)?;
        let beside = self.light_colours.forward(&beside, train)?;
        let hidden = self.light_hidden.forward(x, train)?.f_to_kind(Kind::Float)?.f_add(&beside)?.f_relu()?;
        let light = self.light.forward(&hidden, train)?;
        let hidden = self.area_hidden.forward(&below, learns.part(Part::Area))?.f_relu()?;
        let hidden = hidden.f_to_kind(Kind::Float)?;
        let area = self.area.forward(&hidden, train)?;
        let signs = self.find_signs(x, pictures, learns.part(Part::Signs))?;
        Ok(Some(RoadAnswer { light, lanes, signs, area }))
    }

    fn find_signs(&self, x: &Tensor, pictures: &Tensor, train: bool) -> Result<Tensor, TchError> {
        let [first, last] = SIGN_ROWS.map(|row| row as i64);
        let stride = STRIDE as i64;
        let pixels = pictures.f_narrow(2, first * stride, (last - first) * stride)?;
        let [stem1, stem2, third] = &self.signs_pixels;
        let pixels = stem1.forward(&pixels, train)?.f_relu()?;
        let pixels = stem2.forward(&pixels, train)?.f_relu()?;
        let pixels = third.forward(&pixels, train)?;
        let near = self.signs_features.forward(&x.f_narrow(2, first, last - first)?, train)?;
        let hidden = self.signs_hidden.forward(&near.f_add(&pixels)?.f_relu()?, train)?.f_relu()?;
        self.signs.forward(&hidden.f_to_kind(Kind::Float)?, train)
    }

    /// Folds every batch norm.
    ///
    /// # Errors
    /// torch fails.
    pub fn fold(&mut self) -> Result<(), TchError> {
        self.light_hidden.fold()?;
        self.signs_pixels.iter_mut().try_for_each(Conv::fold)?;
        self.signs_features.fold()?;
        self.signs_hidden.fold()?;
        self.area_hidden.fold()?;
        self.hidden.fold()
    }
}
