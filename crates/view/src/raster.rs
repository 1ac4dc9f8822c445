//! A small software rasteriser: orthographic camera, z-buffer, smooth normals.
//!
//! Shading happens at twice the resolution and is averaged down in linear
//! light. Light: one soft key light fixed to the camera (upper left), a sky
//! that is brighter above, and darkening where nearer surfaces surround a
//! pixel in the depth buffer (screen-space ambient occlusion), which is what
//! separates one layer from the next. Both sides of a surface are lit; the
//! back side is darker, so that the inside of a hem or sleeve can be told from
//! its outside. Triangles with a corner that is not finite are left out;
//! callers report them ([`not_finite`]).

use drape_geometry::normals::vertex_normals;
use drape_geometry::vector::{cross, dot, sub};

use crate::picture::{Picture, Rgb};

/// Samples along a pixel's side.
const SUPERSAMPLING: usize = 2;
/// Brightness of a back side relative to a front side.
const BACK_SIDE: f32 = 0.62;
/// Share of light taken away where a pixel is completely surrounded.
const OCCLUSION_STRENGTH: f32 = 0.75;
/// Reach of the occlusion, as a share of the picture's height.
const OCCLUSION_REACH: f32 = 0.022;
/// Samples of the depth buffer for one pixel's occlusion.
const OCCLUSION_SAMPLES: usize = 16;

/// One mesh to draw.
#[derive(Clone, Copy, Debug)]
pub struct Surface<'a> {
    /// Vertex positions, `[vertex, 3]`.
    pub positions: &'a [[f32; 3]],
    /// Triangles, counter-clockwise seen from outside; indices must be valid.
    pub faces: &'a [[u32; 3]],
    /// Colour.
    pub paint: Paint<'a>,
}

/// Colour of a surface.
#[derive(Clone, Copy, Debug)]
pub enum Paint<'a> {
    /// One colour.
    Plain(Rgb),
    /// A colour for each face, `[face]`.
    Faces(&'a [Rgb]),
}

/// Orthographic camera.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    /// Point in the middle of the picture.
    pub centre: [f32; 3],
    /// Unit vector to the right of the picture.
    pub right: [f32; 3],
    /// Unit vector to the top of the picture.
    pub up: [f32; 3],
    /// Unit vector towards the viewer.
    pub back: [f32; 3],
    /// Scene units for one pixel.
    pub units_per_pixel: f32,
}

impl Camera {
    /// A camera in a world with Z up. Azimuth 0 looks along +Y, so that it sees
    /// a person who faces −Y from the front; azimuth 90° looks from +X along
    /// −X. A positive elevation looks from above. `units_per_pixel` is 1 until
    /// [`Camera::frame`] sets it.
    pub fn looking(azimuth_degrees: f32, elevation_degrees: f32) -> Self {
        let (sin_a, cos_a) = azimuth_degrees.to_radians().sin_cos();
        let (sin_e, cos_e) = elevation_degrees.to_radians().sin_cos();
        let back = [sin_a * cos_e, -cos_a * cos_e, sin_e];
        let right = [cos_a, sin_a, 0.0];
        Self {
            centre: [0.0; 3],
            right,
            up: cross(back, right),
            back,
            units_per_pixel: 1.0,
        }
    }

    /// Width and height that `points` take in the picture, in scene units;
    /// `None` without finite points.
    pub fn extent(&self, points: &[[f32; 3]]) -> Option<[f32; 2]> {
        let (low, high) = self.range(points)?;
        Some([high[0] - low[0], high[1] - low[1]])
    }

    /// Moves and zooms so that `points` fill a picture but for a margin of 5 %
    /// on each side. Without finite points the camera stays as it is.
    pub fn frame(mut self, points: &[[f32; 3]], width: usize, height: usize) -> Self {
        let Some((low, high)) = self.range(points) else {
            return self;
        };
        let axes = [self.right, self.up, self.back];
        let middle: [f32; 3] = std::array::from_fn(|axis| (low[axis] + high[axis]) / 2.0);
        self.centre = std::array::from_fn(|i| (0..3).map(|k| middle[k] * axes[k][i]).sum());
        let fill = 0.9;
        let across = (high[0] - low[0]) / (fill * width as f32);
        let upright = (high[1] - low[1]) / (fill * height as f32);
        self.units_per_pixel = across.max(upright).max(f32::MIN_POSITIVE);
        self
    }

    /// Lowest and highest place along right, up and back.
    fn range(&self, points: &[[f32; 3]]) -> Option<([f32; 3], [f32; 3])> {
        let axes = [self.right, self.up, self.back];
        let mut low = [f32::INFINITY; 3];
        let mut high = [f32::NEG_INFINITY; 3];
        for point in points.iter().filter(|p| p.iter().all(|x| x.is_finite())) {
            for axis in 0..3 {
                let along = dot(*point, axes[axis]);
                low[axis] = low[axis].min(along);
                high[axis] = high[axis].max(along);
            }
        }
        (low[0] <= high[0]).then_some((low, high))
    }
}

/// Number of vertices with a NaN or an infinity.
pub fn not_finite(positions: &[[f32; 3]]) -> usize {
    positions
        .iter()
        .filter(|p| !p.iter().all(|x| x.is_finite()))
        .count()
}

/// Draws surfaces on a background.
pub fn render(
    surfaces: &[Surface],
    camera: &Camera,
    width: usize,
    height: usize,
    background: Rgb,
) -> Picture {
    let mut buffer = Buffer::new(width * SUPERSAMPLING, height * SUPERSAMPLING);
    for surface in surfaces {
        buffer.draw(surface, camera);
    }
    buffer.occlude(camera.units_per_pixel / SUPERSAMPLING as f32);
    buffer.resolve(width, height, background)
}

/// Depth and linear light at the finer resolution.
struct Buffer {
    width: usize,
    height: usize,
    /// Distance towards the viewer, −∞ where nothing was drawn.
    depth: Vec<f32>,
    light: Vec<[f32; 3]>,
}

/// A vertex in picture coordinates: x and y in fine pixels, depth in units.
#[derive(Clone, Copy)]
struct Corner {
    at: [f32; 3],
    normal: [f32; 3],
}

impl Buffer {
    fn new(width: usize, height: usize) -> Self {
        let count = width * height;
        Self {
            width,
            height,
            depth: vec![f32::NEG_INFINITY; count],
            light: vec![[0.0; 3]; count],
        }
    }

    fn draw(&mut self, surface: &Surface, camera: &Camera) {
        let per_unit = SUPERSAMPLING as f32 / camera.units_per_pixel;
        let normals = vertex_normals(surface.positions, surface.faces);
        let corners: Vec<Corner> = surface
            .positions
            .iter()
            .zip(&normals)
            .map(|(&position, &normal)| {
                let from_centre = sub(position, camera.centre);
                let x = self.width as f32 / 2.0 + dot(from_centre, camera.right) * per_unit;
                let y = self.height as f32 / 2.0 - dot(from_centre, camera.up) * per_unit;
                let turned = [camera.right, camera.up, camera.back].map(|axis| dot(normal, axis));
                Corner {
                    at: [x, y, dot(from_centre, camera.back)],
                    normal: turned,
                }
            })
            .collect();
        for (face, indices) in surface.faces.iter().enumerate() {
            let colour = match surface.paint {
                Paint::Plain(colour) => colour,
                Paint::Faces(colours) => colours[face],
            };
            self.draw_triangle(indices.map(|i| corners[i as usize]), colour.map(to_linear));
        }
    }

    fn draw_triangle(&mut self, [a, b, c]: [Corner; 3], colour: [f32; 3]) {
        let edge = |p: [f32; 3], q: [f32; 3], x: f32, y: f32| {
            (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
        };
        // y points down: a face that looks at the viewer turns clockwise here.
        let area = edge(a.at, b.at, c.at[0], c.at[1]);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        let front = area < 0.0;
        let range = |axis: usize, size: usize| {
            let values = [a.at[axis], b.at[axis], c.at[axis]];
            let low = values.iter().copied().fold(f32::INFINITY, f32::min);
            let high = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            // Casts from floats saturate, so places far outside stay harmless.
            (
                low.floor().max(0.0) as usize,
                ((high.ceil() + 1.0).max(0.0) as usize).min(size),
            )
        };
        let ((x0, x1), (y0, y1)) = (range(0, self.width), range(1, self.height));
        for y in y0..y1 {
            for x in x0..x1 {
                let (px, py) = (x as f32 + 0.5, y as f32 + 0.5);
                let u = edge(b.at, c.at, px, py) / area;
                let v = edge(c.at, a.at, px, py) / area;
                let w = 1.0 - u - v;
                if u < 0.0 || v < 0.0 || w < 0.0 {
                    continue;
                }
                let depth = u * a.at[2] + v * b.at[2] + w * c.at[2];
                let pixel = y * self.width + x;
                if depth > self.depth[pixel] {
                    self.depth[pixel] = depth;
                    let normal = std::array::from_fn(|i| {
                        u * a.normal[i] + v * b.normal[i] + w * c.normal[i]
                    });
                    let brightness = shade(normal, front);
                    self.light[pixel] = colour.map(|channel| channel * brightness);
                }
            }
        }
    }

    /// Darkens pixels that nearer surfaces surround.
    fn occlude(&mut self, units_per_sample: f32) {
        let reach = OCCLUSION_REACH * self.height as f32;
        let reach_units = reach * units_per_sample;
        // Sunflower pattern: even, the same everywhere, no random numbers.
        let pattern: Vec<(f32, f32)> = (0..OCCLUSION_SAMPLES)
            .map(|i| {
                let radius = reach * ((i as f32 + 0.5) / OCCLUSION_SAMPLES as f32).sqrt();
                let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
                (radius * cos, radius * sin)
            })
            .collect();
        let depth_at = |x: isize, y: isize| {
            let inside =
                (0..self.width as isize).contains(&x) && (0..self.height as isize).contains(&y);
            if inside {
                self.depth[y as usize * self.width + x as usize]
            } else {
                f32::NEG_INFINITY
            }
        };
        for y in 0..self.height as isize {
            for x in 0..self.width as isize {
                let pixel = y as usize * self.width + x as usize;
                let depth = self.depth[pixel];
                if depth == f32::NEG_INFINITY {
                    continue;
                }
                // Opposite samples in pairs: a slanted plane is as much nearer
                // on one side as it is farther on the other and stays bright.
                let blocked: f32 = pattern
                    .iter()
                    .map(|&(dx, dy)| {
                        let (dx, dy) = (dx.round() as isize, dy.round() as isize);
                        let rise = |z: f32| (z - depth).clamp(-reach_units, reach_units);
                        let one = rise(depth_at(x + dx, y + dy));
                        let other = rise(depth_at(x - dx, y - dy));
                        ((one + other) / reach_units).clamp(0.0, 1.0)
                    })
                    .sum();
                let open = 1.0 - OCCLUSION_STRENGTH * (blocked / OCCLUSION_SAMPLES as f32).sqrt();
                self.light[pixel] = self.light[pixel].map(|channel| channel * open);
            }
        }
    }

    fn resolve(&self, width: usize, height: usize, background: Rgb) -> Picture {
        let mut picture = Picture::new(width, height, background);
        let background = background.map(to_linear);
        for y in 0..height {
            for x in 0..width {
                let mut sum = [0.0f32; 3];
                for sample in 0..SUPERSAMPLING * SUPERSAMPLING {
                    let (sx, sy) = (sample % SUPERSAMPLING, sample / SUPERSAMPLING);
                    let row = y * SUPERSAMPLING + sy;
                    let pixel = row * self.width + x * SUPERSAMPLING + sx;
                    let empty = self.depth[pixel] == f32::NEG_INFINITY;
                    let light = if empty { background } else { self.light[pixel] };
                    for channel in 0..3 {
                        sum[channel] += light[channel];
                    }
                }
                let samples = (SUPERSAMPLING * SUPERSAMPLING) as f32;
                picture.set_pixel(x, y, sum.map(|channel| to_srgb(channel / samples)));
            }
        }
        picture
    }
}

/// Brightness of a surface with a normal in camera axes (right, up, back).
fn shade(normal: [f32; 3], front: bool) -> f32 {
    // The light's own length is 1: (−0.45, 0.55, 0.70) normalised.
    const KEY: [f32; 3] = [-0.451, 0.551, 0.702];
    let length = dot(normal, normal).sqrt().max(f32::MIN_POSITIVE);
    let sign = if front { 1.0 } else { -1.0 };
    let normal = normal.map(|x| sign * x / length);
    // Wrapped Lambert: light reaches a little around the terminator, as from a large lamp.
    let wrapped = ((dot(normal, KEY) + 0.35) / 1.35).max(0.0);
    let sky = 0.5 + 0.5 * normal[1];
    let brightness = 0.16 + 0.16 * sky + 0.78 * wrapped * wrapped.sqrt();
    if front {
        brightness
    } else {
        brightness * BACK_SIDE
    }
}

fn to_linear(channel: u8) -> f32 {
    let value = f32::from(channel) / 255.0;
    if value <= 0.04045 {
        value / 12.92
    } else {
        ((value + 0.055) / 1.055).powf(2.4)
    }
}

fn to_srgb(value: f32) -> u8 {
    let value = value.clamp(0.0, 1.0);
    let curved = if value <= 0.003_130_8 {
        value * 12.92
    } else {
        1.055 * value.powf(1.0 / 2.4) - 0.055
    };
    (curved * 255.0 + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    const RED: Rgb = [200, 30, 30];
    const BLUE: Rgb = [30, 30, 200];
    const QUAD: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];

    /// Square in the XZ plane at depth y whose front looks along −Y.
    fn square(y: f32, half: f32) -> [[f32; 3]; 4] {
        [
            [-half, y, -half],
            [half, y, -half],
            [half, y, half],
            [-half, y, half],
        ]
    }

    fn draw(surfaces: &[(&[[f32; 3]], Rgb)], azimuth: f32) -> Picture {
        let surfaces: Vec<Surface> = surfaces
            .iter()
            .map(|&(positions, colour)| Surface {
                positions,
                faces: &QUAD,
                paint: Paint::Plain(colour),
            })
            .collect();
        let frame = square(0.0, 1.0);
        let camera = Camera::looking(azimuth, 0.0).frame(&frame, 40, 40);
        render(&surfaces, &camera, 40, 40, [255; 3])
    }

    #[test]
    fn the_nearer_surface_hides_the_farther_one_in_any_order() {
        let (near, far) = (square(-1.0, 0.5), square(1.0, 1.0));
        for surfaces in [
            [(&near[..], RED), (&far[..], BLUE)],
            [(&far[..], BLUE), (&near[..], RED)],
        ] {
            let picture = draw(&surfaces, 0.0);
            let (centre, side) = (picture.pixel(20, 20), picture.pixel(4, 20));
            assert!(centre[0] > centre[2] && side[2] > side[0]);
            assert_eq!(picture.pixel(0, 0), [255; 3]);
            let from_behind = draw(&surfaces, 180.0).pixel(20, 20);
            assert!(from_behind[2] > from_behind[0]);
        }
    }

    #[test]
    fn a_back_side_is_darker_than_a_front_side() {
        let quad = square(0.0, 1.0);
        let front = draw(&[(&quad, RED)], 0.0).pixel(20, 20);
        let back = draw(&[(&quad, RED)], 180.0).pixel(20, 20);
        assert!(back[0] < front[0] && back[0] > 60);
    }

    #[test]
    fn triangles_that_are_not_finite_or_far_outside_leave_no_trace() {
        let mut broken = square(0.0, 1.0);
        broken[1][0] = f32::NAN;
        broken[3][2] = 1e30;
        assert_eq!(not_finite(&broken), 1);
        let picture = draw(&[(&broken, RED)], 0.0);
        assert_eq!((picture.width(), picture.height()), (40, 40));
        assert_eq!(picture.pixel(39, 39), [255; 3]);
    }
}
