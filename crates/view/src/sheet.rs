//! Contact sheets: frames in columns; a row for each clip and view.
//!
//! Two views look in opposite horizontal directions, slightly from above and
//! from the side, which shows folds better than straight on. All cells share
//! one scale. The picture follows the person horizontally (the mean of the
//! first clip's body) but not vertically, so a walk stays in its cell and a
//! squat still goes down. With several clips (reference above, prediction
//! below), cells of a column use the same camera: differences that one sees
//! are real.

use drape_dataset::sequence::{Frame, SequenceHeader};

use crate::error::ViewError;
use crate::picture::{Anchor, Picture, Rgb, text_width};
use crate::raster::{Camera, Paint, Surface, not_finite, render};

/// Paper of all sheets.
pub(crate) const BACKGROUND: Rgb = [244, 243, 240];
/// Ink of labels.
pub(crate) const INK: Rgb = [50, 50, 54];
/// Colour of the body.
const BODY: Rgb = [205, 188, 178];
/// Colours of garments, inner layer first; more garments begin again.
const GARMENTS: [Rgb; 6] = [
    [236, 188, 82],
    [70, 130, 196],
    [208, 96, 84],
    [104, 168, 112],
    [150, 118, 190],
    [222, 138, 176],
];
/// Garments that stray farther than this share of the first clip's body height
/// from the body do not make the person smaller; they leave the cell.
const STRAY: f32 = 0.4;
const TITLE_HEIGHT: usize = 40;
const STRIP_HEIGHT: usize = 20;
const LABEL_WIDTH: usize = 110;

/// Frames of one sequence to show in one row per view.
#[derive(Clone, Debug)]
pub struct Clip<'a> {
    /// Name beside the row, for example `reference`.
    pub label: &'a str,
    /// Meshes and names.
    pub header: &'a SequenceHeader,
    /// Frames with their numbers, one per column.
    pub frames: Vec<(usize, &'a Frame)>,
}

/// Size and directions of a sheet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SheetOptions {
    /// Height of a cell in pixels; its width follows from what has to fit.
    pub cell_height: usize,
    /// Direction of the first view in degrees: 0 sees a person who faces −Y
    /// from the front, larger values walk around to the person's left.
    pub azimuth_degrees: f32,
    /// Degrees from above.
    pub elevation_degrees: f32,
}

impl Default for SheetOptions {
    fn default() -> Self {
        Self {
            cell_height: 400,
            azimuth_degrees: 24.0,
            elevation_degrees: 8.0,
        }
    }
}

/// `count` frame numbers spread evenly over a sequence, with its first and last frame.
pub fn spread(frame_count: usize, count: usize) -> Vec<usize> {
    let count = count.min(frame_count);
    let last = frame_count.saturating_sub(1);
    (0..count)
        .map(|i| {
            if count == 1 {
                0
            } else {
                (i * last + (count - 1) / 2) / (count - 1)
            }
        })
        .collect()
}

/// Draws clips below each other: the front view of each, then the back view of each.
///
/// # Errors
/// No clips or frames; clips with different numbers of frames; positions that
/// do not fit their header's meshes.
pub fn contact_sheet(clips: &[Clip], options: &SheetOptions) -> Result<Picture, ViewError> {
    let Some(first) = clips.first() else {
        return Err(ViewError::Empty {
            what: "contact sheet",
            item: "clip",
        });
    };
    if first.frames.is_empty() {
        return Err(ViewError::Empty {
            what: "contact sheet",
            item: "frame",
        });
    }
    for clip in clips {
        check(clip, first.frames.len())?;
    }
    let follow: Vec<[f32; 3]> = first
        .frames
        .iter()
        .map(|(_, frame)| standing(frame))
        .collect();
    let framed = framed_points(first, &follow);
    let views = [
        ("front", options.azimuth_degrees),
        ("back", options.azimuth_degrees + 180.0),
    ]
    .map(|(name, azimuth)| (name, Camera::looking(azimuth, options.elevation_degrees)));
    let height = options.cell_height;
    let aspect = views[0].1.extent(&framed).map_or(1.0, |[w, h]| w / h);
    let width = (height as f32 * aspect.clamp(0.3, 1.6)) as usize;

    let columns = first.frames.len();
    let rows = views.len() * clips.len();
    let row_height = height + STRIP_HEIGHT;
    let mut sheet = Picture::new(
        LABEL_WIDTH + columns * width,
        TITLE_HEIGHT + rows * row_height,
        BACKGROUND,
    );
    draw_title(&mut sheet, first)?;
    let mut top = TITLE_HEIGHT;
    for (view, camera) in &views {
        let camera = camera.frame(&framed, width, height);
        for clip in clips {
            let middle = top + row_height / 2;
            sheet.text((14, middle - 10), clip.label, 14.0, Anchor::Left, INK)?;
            sheet.text((14, middle + 10), view, 13.0, Anchor::Left, [130, 130, 134])?;
            for (column, (number, frame)) in clip.frames.iter().enumerate() {
                let centre = std::array::from_fn(|i| camera.centre[i] + follow[column][i]);
                let camera = Camera { centre, ..camera };
                let cell = draw_frame(clip.header, frame, &camera, width, height);
                let left = LABEL_WIDTH + column * width;
                sheet.paste(&cell, left, top + STRIP_HEIGHT);
                let place = (left + width / 2, top + STRIP_HEIGHT / 2);
                sheet.text(place, &format!("frame {number}"), 13.0, Anchor::Centre, INK)?;
                let broken: usize = frame.garments.iter().map(|g| not_finite(g)).sum();
                if broken > 0 {
                    let text = format!("vertices not finite: {broken}");
                    let place = (left + width / 2, top + row_height - 10);
                    sheet.text(place, &text, 12.0, Anchor::Centre, [190, 20, 20])?;
                }
            }
            top += row_height;
        }
    }
    Ok(sheet)
}

/// Colour of garment `index` of an outfit.
pub(crate) fn garment_colour(index: usize) -> Rgb {
    GARMENTS[index % GARMENTS.len()]
}

/// Checks that a mesh can be drawn.
pub(crate) fn check_mesh(
    place: impl Fn() -> String,
    vertex_count: usize,
    faces: &[[u32; 3]],
) -> Result<(), ViewError> {
    let beyond = |f: &[u32; 3]| f.iter().any(|&v| v as usize >= vertex_count);
    match faces.iter().position(beyond) {
        None => Ok(()),
        Some(face) => {
            let vertex = faces[face].into_iter().max().unwrap_or_default();
            let defect = drape_geometry::GeometryError::IndexOutOfRange {
                face,
                vertex,
                vertex_count,
            };
            Err(ViewError::Mesh {
                place: place(),
                defect,
            })
        }
    }
}

fn check(clip: &Clip, columns: usize) -> Result<(), ViewError> {
    let mismatch = |place: String, expected: String, found: String| {
        Err(ViewError::Mismatch {
            place,
            expected,
            found,
        })
    };
    let name = clip.label;
    if clip.frames.len() != columns {
        let found = format!("{}", clip.frames.len());
        return mismatch(format!("clip {name}"), format!("{columns} frames"), found);
    }
    for (number, frame) in &clip.frames {
        let place = |part: &str| format!("clip {name}, frame {number}, {part}");
        let garments = &clip.header.garments;
        if frame.garments.len() != garments.len() {
            let found = format!("{}", frame.garments.len());
            return mismatch(place("garments"), format!("{}", garments.len()), found);
        }
        check_mesh(|| place("body"), frame.body.len(), &clip.header.body.faces)?;
        for (garment, positions) in garments.iter().zip(&frame.garments) {
            check_mesh(|| place(&garment.name), positions.len(), &garment.faces)?;
        }
    }
    Ok(())
}

fn draw_title(sheet: &mut Picture, clip: &Clip) -> Result<(), ViewError> {
    let middle = TITLE_HEIGHT / 2;
    sheet.text((14, middle), &clip.header.name, 18.0, Anchor::Left, INK)?;
    let mut right = sheet.width() - 14;
    for (index, garment) in clip.header.garments.iter().enumerate().rev() {
        sheet.text((right, middle), &garment.name, 14.0, Anchor::Right, INK)?;
        right = right.saturating_sub(text_width(&garment.name, 14.0)? + 20);
        sheet.paste(
            &Picture::new(14, 14, garment_colour(index)),
            right,
            middle - 7,
        );
        right = right.saturating_sub(18);
    }
    Ok(())
}

fn draw_frame(
    header: &SequenceHeader,
    frame: &Frame,
    camera: &Camera,
    width: usize,
    height: usize,
) -> Picture {
    let body = Surface {
        positions: &frame.body,
        faces: &header.body.faces,
        paint: Paint::Plain(BODY),
    };
    let garments = header.garments.iter().zip(&frame.garments).enumerate();
    let garments = garments.map(|(index, (garment, positions))| Surface {
        positions,
        faces: &garment.faces,
        paint: Paint::Plain(garment_colour(index)),
    });
    let surfaces: Vec<Surface> = std::iter::once(body).chain(garments).collect();
    render(&surfaces, camera, width, height, BACKGROUND)
}

/// Horizontal mean of the body, of the garments where there is no body.
fn standing(frame: &Frame) -> [f32; 3] {
    let points: Vec<&[f32; 3]> = if frame.body.is_empty() {
        frame.garments.iter().flatten().collect()
    } else {
        frame.body.iter().collect()
    };
    let finite = points.iter().filter(|p| p.iter().all(|x| x.is_finite()));
    let (mut sum, mut count) = ([0.0f64; 2], 0.0);
    for point in finite {
        sum = [sum[0] + f64::from(point[0]), sum[1] + f64::from(point[1])];
        count += 1.0;
    }
    let [x, y] = sum.map(|s| if count > 0.0 { (s / count) as f32 } else { 0.0 });
    [x, y, 0.0]
}

/// What has to fit into a cell: bodies and garments of all frames, each
/// shifted to where the picture follows it.
fn framed_points(clip: &Clip, follow: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let shifted = |points: &[[f32; 3]], by: [f32; 3]| -> Vec<[f32; 3]> {
        points
            .iter()
            .map(|p| std::array::from_fn(|axis| p[axis] - by[axis]))
            .collect()
    };
    let frames = || clip.frames.iter().zip(follow);
    let mut framed: Vec<[f32; 3]> = frames()
        .flat_map(|((_, frame), &by)| shifted(&frame.body, by))
        .collect();
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for point in framed.iter().filter(|p| p.iter().all(|x| x.is_finite())) {
        for axis in 0..3 {
            low[axis] = low[axis].min(point[axis]);
            high[axis] = high[axis].max(point[axis]);
        }
    }
    // Without a body there is nothing to stray from.
    let margin = if low[2] <= high[2] {
        STRAY * (high[2] - low[2])
    } else {
        f32::INFINITY
    };
    let near = |p: &[f32; 3]| {
        margin == f32::INFINITY
            || (0..3).all(|i| p[i] >= low[i] - margin && p[i] <= high[i] + margin)
    };
    for ((_, frame), &by) in frames() {
        for garment in &frame.garments {
            framed.extend(shifted(garment, by).into_iter().filter(near));
        }
    }
    framed
}

#[cfg(test)]
pub(crate) mod tests {
    use drape_dataset::registry::GarmentKind;
    use drape_dataset::sequence::{BodyTopology, Garment, Material, SceneMeta};

    use super::*;

    /// A flat person (two triangles, facing -Y) with one triangle of cloth in front.
    pub(crate) fn header() -> SequenceHeader {
        SequenceHeader {
            name: "flat".into(),
            scene: SceneMeta {
                scale: 10.0,
                fps: 30.0,
                seed: 0,
                engine: "by hand".into(),
                engine_version: "1".into(),
                effects: vec![],
                gravity: [0.0, 0.0, -98.1],
                body_friction: 60.0,
                metres_per_uv: 1.0,
                recipe: String::new(),
                warnings: vec![],
            },
            body: BodyTopology {
                rest: vec![],
                faces: vec![[0, 1, 2], [0, 2, 3]],
                vertex_count: 4,
            },
            garments: vec![Garment {
                name: "sheet".into(),
                kind: GarmentKind::Skirt,
                layer: 0,
                rest: vec![[-2., -1., 4.], [2., -1., 4.], [0., -1., 12.]],
                faces: vec![[0, 1, 2]],
                uv: vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
                uv_faces: vec![[0, 1, 2]],
                panel_of_face: vec![0],
                panels: vec!["front".into()],
                material: Material {
                    mass: 0.3,
                    tension: 50.0,
                    compression: 50.0,
                    shear: 50.0,
                    bending: 50.0,
                    friction: 60.0,
                },
            }],
        }
    }

    fn frame_at(x: f32, y: f32) -> Frame {
        let body = [[-3., 0., 0.], [3., 0., 0.], [3., 0., 17.], [-3., 0., 17.]];
        let moved = |p: &[f32; 3]| [p[0] + x, p[1] + y, p[2]];
        Frame {
            body: body.iter().map(moved).collect(),
            garments: vec![header().garments[0].rest.iter().map(moved).collect()],
            ..Frame::default()
        }
    }

    fn sheet_of(frames: &[Frame]) -> Result<Picture, ViewError> {
        let header = header();
        let clip = Clip {
            label: "clip",
            header: &header,
            frames: frames.iter().enumerate().collect(),
        };
        contact_sheet(
            &[clip],
            &SheetOptions {
                cell_height: 80,
                ..SheetOptions::default()
            },
        )
    }

    #[test]
    fn a_walk_stays_in_its_cell_however_far_it_goes() {
        let still = sheet_of(&[frame_at(0.0, 0.0), frame_at(0.0, 0.0)]).unwrap();
        let walk = sheet_of(&[frame_at(0.0, 0.0), frame_at(64.0, -512.0)]).unwrap();
        // Far from the origin f32 rounds differently: samples at outlines may flip.
        let differing = (0..still.width() * still.height())
            .map(|i| (i % still.width(), i / still.width()))
            .filter(|&(x, y)| still.pixel(x, y) != walk.pixel(x, y))
            .count();
        assert!(
            differing * 200 < still.width() * still.height(),
            "{differing} pixels differ"
        );
    }

    #[test]
    fn an_exploded_vertex_leaves_the_person_as_large_as_before() {
        let sound = frame_at(0.0, 0.0);
        let mut exploded = sound.clone();
        exploded.garments[0][2] = [0.0, -1e5, 1e5];
        let (before, after) = (sheet_of(&[sound]).unwrap(), sheet_of(&[exploded]).unwrap());
        assert_eq!(
            (before.width(), before.height()),
            (after.width(), after.height())
        );
        // The person's feet and the paper beside them.
        let row = TITLE_HEIGHT + STRIP_HEIGHT + 74;
        for x in LABEL_WIDTH..before.width() {
            assert_eq!(before.pixel(x, row), after.pixel(x, row));
        }
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let mut short = frame_at(0.0, 0.0);
        short.garments[0].pop();
        let message = sheet_of(&[frame_at(0.0, 0.0), short.clone()])
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("frame 1") && message.contains("sheet"),
            "{message}"
        );
        short.garments.clear();
        let message = sheet_of(&[short]).unwrap_err().to_string();
        assert!(message.contains("expected 1, found 0"), "{message}");
        assert!(matches!(sheet_of(&[]), Err(ViewError::Empty { .. })));
        assert!(matches!(
            contact_sheet(&[], &SheetOptions::default()),
            Err(ViewError::Empty { .. })
        ));
    }

    #[test]
    fn a_frame_that_is_not_finite_is_drawn_and_says_so() {
        let mut broken = frame_at(0.0, 0.0);
        broken.garments[0][1][0] = f32::NAN;
        let sheet = sheet_of(&[broken]).unwrap();
        let pixels = (0..sheet.height()).flat_map(|y| (0..sheet.width()).map(move |x| (x, y)));
        let red = pixels.filter(|&(x, y)| {
            let [r, g, b] = sheet.pixel(x, y);
            r > 150 && g < 90 && b < 90
        });
        assert!(red.count() > 20);
    }

    #[test]
    fn spread_frames_are_even_and_hold_both_ends() {
        assert_eq!(spread(54, 6), [0, 11, 21, 32, 42, 53]);
        assert_eq!(spread(3, 6), [0, 1, 2]);
        assert_eq!(spread(10, 1), [0]);
        assert!(spread(0, 6).is_empty());
    }
}
