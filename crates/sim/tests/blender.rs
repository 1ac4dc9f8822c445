//! Sequences made with Blender. What needs Blender itself prints why it does
//! not run where there is none; the rest runs against a stand-in on Unix.

use std::ops::ControlFlow;

use drape_dataset::SequenceReader;
use drape_dataset::registry::{Effect, GarmentKind};
use drape_dataset::sequence::{Frame, Intersections, SequenceHeader};
use drape_sim::SimError;
use drape_sim::blender::{Blender, BlenderSettings};
use drape_sim::motion::LeadIn;
use drape_sim::scene::{Progress, Recipe, SceneRanges, simulate, simulate_in_blender};

/// Pants and skirt, coarse and short, in wind.
fn recipe() -> Recipe {
    let ranges = SceneRanges {
        outfits: vec![vec![GarmentKind::Pants, GarmentKind::Skirt]],
        outfit_vertices: 500.0,
        calm_share: 0.0,
        lead_in: LeadIn { still: 2, ease: 3 },
        ..SceneRanges::default()
    };
    let settings = BlenderSettings {
        quality: 5,
        ..BlenderSettings::default()
    };
    ranges
        .sample("tiny", 0, 3, 3, &Default::default())
        .for_blender(&settings)
}

fn go_on(_: Progress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Largest difference of two lists of positions.
fn apart<'a>(pairs: impl Iterator<Item = (&'a [f32; 3], &'a [f32; 3])>) -> f32 {
    pairs
        .flat_map(|(a, b)| (0..3).map(|k| (a[k] - b[k]).abs()))
        .fold(0.0, f32::max)
}

#[test]
fn where_blender_is_installed_the_same_scene_is_simulated_by_both_engines() {
    let blender = match Blender::find() {
        Ok(blender) => blender,
        Err(reason) => return eprintln!("not tested: {reason}"),
    };
    let recipe = recipe();
    let (header, frames) = simulate_in_blender(&recipe, &blender, go_on).unwrap();
    let (ours, our_frames) = simulate(&recipe, None, go_on).unwrap();
    assert_eq!(header.scene.engine, "blender");
    assert_eq!(header.scene.engine_version, blender.version());
    assert!(!header.scene.effects.contains(&Effect::Shear));
    assert_eq!(header.scene.gravity, recipe.gravity);
    assert_eq!(Recipe::from_json(&header.scene.recipe).unwrap(), recipe);
    assert_eq!(frames.len(), recipe.frames);
    assert_eq!(header.body, ours.body);
    header.check().unwrap();
    for (theirs, ours) in frames.iter().zip(&our_frames) {
        theirs.check(&header).unwrap();
        assert_eq!((&theirs.body, theirs.root), (&ours.body, ours.root));
        assert_eq!(theirs.wind, ours.wind);
        assert!(theirs.intersections.is_some());
    }
    waist_bands_coincide(&header, &frames, &our_frames);
    // Cloth that hung and was blown at for eight frames is not at rest.
    let last = frames.last().unwrap();
    for (garment, positions) in header.garments.iter().zip(&last.garments) {
        let moved = apart(garment.rest.iter().zip(positions));
        assert!((0.01..10.0).contains(&moved), "{}: {moved}", garment.name);
    }
}

/// Vertices that follow the body are in the same places with both engines.
fn waist_bands_coincide(header: &SequenceHeader, theirs: &[Frame], ours: &[Frame]) {
    for (number, garment) in header.garments.iter().enumerate() {
        let highest = (0..garment.rest.len())
            .max_by(|&a, &b| garment.rest[a][2].total_cmp(&garment.rest[b][2]))
            .unwrap();
        for (a, b) in theirs.iter().zip(ours) {
            let pair = (&a.garments[number][highest], &b.garments[number][highest]);
            let off = apart([pair].into_iter());
            assert!(off < 1e-3, "{}: {off} units", garment.name);
        }
    }
}

#[test]
fn a_recipe_without_blenders_settings_is_refused() {
    let Ok(blender) = Blender::find() else {
        return eprintln!("not tested: no Blender here");
    };
    let mut recipe = recipe();
    recipe.blender = None;
    let error = simulate_in_blender(&recipe, &blender, go_on).unwrap_err();
    assert!(error.to_string().contains("recipe.blender"), "{error}");
}

/// A shell script in Blender's place.
#[cfg(unix)]
mod stand_in {
    use std::fs;
    use std::os::unix::fs::PermissionsExt;
    use std::process::{Command, Output};

    use super::*;
    use tempfile::TempDir;

    /// Answers the question for its version, and runs `body` as the simulation;
    /// `$2` is the folder with its files.
    fn blender(body: &str) -> (TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("python");
        let script = format!(
            "#!/bin/sh\nif [ \"$1\" = -c ]; then echo 'bpy 9.9 stand-in'; exit 0; fi\n{body}\n"
        );
        fs::write(&path, script).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        // A process that another test starts just now may hold the file open until it is itself.
        let busy = || {
            Command::new(&path)
                .arg("-c")
                .output()
                .is_err_and(|error| error.kind() == std::io::ErrorKind::ExecutableFileBusy)
        };
        while busy() {}
        (folder, path)
    }

    /// Leaves the garments at rest for so many frames.
    const STILL: &str = "echo chatter
        for n in 1 2 3 4 5 6 7 8; do
            cp \"$2/cloth_rest.f32\" \"$2/frame_0000$n.f32\"; echo \"drape-frame $n\"
        done";

    /// [`STILL`] with another way to make a frame of the garments at rest.
    fn written_by(filter: &str) -> String {
        STILL.replace(
            "cp \"$2/cloth_rest.f32\" \"$2/frame_0000$n.f32\"",
            &format!("{filter} > \"$2/frame_0000$n.f32\""),
        )
    }

    /// Every byte of the garments at rest is this one.
    fn all_bytes(octal: &str) -> String {
        written_by(&format!(
            "tr '\\000-\\377' '\\{octal}' < \"$2/cloth_rest.f32\""
        ))
    }

    fn run(body: &str) -> Result<(SequenceHeader, Vec<Frame>), SimError> {
        let (_folder, path) = blender(body);
        simulate_in_blender(&recipe(), &Blender::with_python(path).unwrap(), go_on)
    }

    #[test]
    fn what_blender_writes_is_what_is_recorded() {
        let (header, frames) = run(STILL).unwrap();
        assert_eq!(header.scene.engine_version, "9.9 stand-in");
        for frame in &frames {
            for (garment, positions) in header.garments.iter().zip(&frame.garments) {
                assert_eq!(&garment.rest, positions);
            }
        }
    }

    #[test]
    fn a_blender_that_dies_is_reported_with_its_last_words() {
        let dies = STILL.replace("3 4 5 6 7 8", "") + "\necho 'out of cloth' >&2; exit 7";
        let message = run(&dies).unwrap_err().to_string();
        assert!(message.contains("after frame 2"), "{message}");
        assert!(message.contains("out of cloth"), "{message}");
        assert!(message.contains('7'), "{message}");
    }

    #[test]
    fn frames_that_are_cut_short_or_not_numbers_are_refused_by_frame() {
        let short = "echo short > \"$2/frame_00001.f32\"; echo drape-frame 1";
        let message = run(short).unwrap_err().to_string();
        assert!(message.contains("frame 1: expected"), "{message}");
        let missing = run("echo drape-frame 1").unwrap_err().to_string();
        assert!(missing.contains("cannot read frame 1"), "{missing}");
        let nan = all_bytes("377");
        let message = run(&nan).unwrap_err().to_string();
        assert!(message.contains("finite"), "{message}");
    }

    #[test]
    fn stopping_ends_blender_and_its_folder() {
        let one = STILL.replace("2 3 4 5 6 7 8", "");
        let body = format!("echo $$ $2 > \"${{0%/*}}/pid\"\n{one}\nexec sleep 600");
        let (folder, path) = blender(&body);
        let blender = Blender::with_python(path).unwrap();
        let stop = |_: Progress| ControlFlow::Break(());
        let error = simulate_in_blender(&recipe(), &blender, stop).unwrap_err();
        assert!(matches!(error, SimError::Stopped { frame: 1 }), "{error}");
        let told = fs::read_to_string(folder.path().join("pid")).unwrap();
        let (pid, work) = told.trim().split_once(' ').unwrap();
        let alive = Command::new("kill").args(["-0", pid]).output().unwrap();
        assert!(!alive.status.success(), "process {pid} is still there");
        assert!(
            !std::path::Path::new(work).exists(),
            "{work} is still there"
        );
    }

    /// The skirt's last vertices are put where the pants' first ones are.
    fn crossing() -> String {
        written_by(
            "size=$(wc -c < \"$2/cloth_rest.f32\"); third=$((size / 36 * 12)); rest=$((size - third))
            (head -c $rest \"$2/cloth_rest.f32\"; head -c $third \"$2/cloth_rest.f32\")",
        )
    }

    /// All vertices in one place, 48.6 units along each axis: nothing crosses.
    fn clear() -> String {
        all_bytes("102")
    }

    #[test]
    fn intersections_are_counted_in_every_frame() {
        let (_, frames) = run(&crossing()).unwrap();
        assert_eq!(frames.len(), recipe().frames);
        assert!(
            frames
                .iter()
                .all(|f| f.intersections.unwrap() != Intersections::default())
        );
    }

    const TINY: &str = "frames = 3
        attempts = 2
        keep_share = 0.6
        [scene]
        outfits = [[\"pants\", \"skirt\"]]
        outfit_vertices = 500.0
        [scene.lead_in]
        still = 2
        ease = 3
        ";

    fn generate(python: &std::path::Path, out: &std::path::Path) -> Output {
        generate_with(python, out, &[])
    }

    fn generate_with(python: &std::path::Path, out: &std::path::Path, more: &[&str]) -> Output {
        fs::write(out.with_extension("toml"), TINY).unwrap();
        Command::new(env!("CARGO_BIN_EXE_drape-generate"))
            .env("DRAPE_BLENDER_PYTHON", python)
            .args(["--engine", "blender", "--sequences", "2", "--threads", "1"])
            .args(more)
            .arg("--config")
            .arg(out.with_extension("toml"))
            .arg("--out")
            .arg(out)
            .output()
            .unwrap()
    }

    fn printed(output: &Output) -> String {
        let text = [&output.stdout[..], &output.stderr[..]].concat();
        String::from_utf8_lossy(&text).into_owned()
    }

    /// The first `count` starts do `first`, those after them `then`; all are counted.
    fn first_starts(count: usize, first: &str, then: &str) -> String {
        format!(
            "count=\"${{0%/*}}/count\"; echo x >> \"$count\"
            if [ $(wc -l < \"$count\") -le {count} ]; then\n{first}\nelse\n{then}\nfi"
        )
    }

    fn starts(folder: &TempDir) -> usize {
        let counted = fs::read_to_string(folder.path().join("count")).unwrap();
        counted.lines().count()
    }

    #[test]
    fn generate_reports_what_fails_keeps_the_rest_and_goes_on_where_it_was() {
        // Both draws of the first sequence fail, all else does not.
        let fails = "echo 'a bad day' >&2; exit 1";
        let (folder, path) = blender(&first_starts(2, fails, &clear()));
        let out = folder.path().join("data");
        let first = generate(&path, &out);
        let said = printed(&first);
        assert!(!first.status.success(), "{said}");
        assert!(said.contains("a bad day"), "{said}");
        assert!(
            said.contains("1 of 2 (0 were there already, 1 failed)"),
            "{said}"
        );
        let again = generate(&path, &out);
        let said = printed(&again);
        assert!(again.status.success(), "{said}");
        assert!(said.contains("2 of 2 (1 were there already"), "{said}");
        assert_eq!(starts(&folder), 4, "a finished sequence is not made again");
    }

    #[test]
    fn generate_draws_what_is_not_clean_again_and_reports_the_share_accepted() {
        let (folder, path) = blender(&first_starts(1, &crossing(), &clear()));
        let out = folder.path().join("data");
        let output = generate(&path, &out);
        let said = printed(&output);
        assert!(output.status.success(), "{said}");
        assert!(
            said.contains("attempt 1: intersections in frame 0"),
            "{said}"
        );
        assert!(said.contains("1 of 2 at the first draw, 50.0 %"), "{said}");
        assert!(said.contains("6 of 6, none with"), "{said}");
        assert_eq!(starts(&folder), 3);
    }

    #[test]
    fn generate_keeps_no_sequence_that_is_never_clean() {
        let (folder, path) = blender(&crossing());
        let out = folder.path().join("data");
        let output = generate(&path, &out);
        let said = printed(&output);
        assert!(!output.status.success(), "{said}");
        assert!(said.contains("0 of 2"), "{said}");
        assert_eq!(fs::read_dir(&out).unwrap().count(), 0, "{said}");
    }

    #[test]
    fn generate_cuts_before_an_intersection_that_comes_late_enough() {
        // Frame 8 is the last of three recorded ones; two are needed.
        let (folder, path) = blender(&format!(
            "{}\n{}",
            clear().replace("7 8;", "7;"),
            crossing().replace("1 2 3 4 5 6 7 8;", "8;")
        ));
        let out = folder.path().join("data");
        let said = printed(&generate(&path, &out));
        assert!(said.contains("4 of 6, none with"), "{said}");
        let reader = SequenceReader::open(out.join("train_0000.mcap")).unwrap();
        assert_eq!(reader.frame_count(), 2);
        let warnings = reader.header().scene.warnings.join("; ");
        assert!(warnings.contains("2 of 3 frames are kept"), "{warnings}");
    }

    #[test]
    fn generate_does_not_time_effects_in_blender() {
        let (folder, path) = blender(&clear());
        let out = folder.path().join("data");
        let output = generate_with(&path, &out, &["--profile"]);
        let said = printed(&output);
        assert!(!output.status.success(), "{said}");
        assert!(
            said.contains("--profile: expected --engine drape"),
            "{said}"
        );
        assert!(!out.exists());
    }

    #[test]
    fn generate_without_blender_says_how_to_get_it_and_makes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("data");
        let output = generate(&folder.path().join("no-python"), &out);
        assert!(!output.status.success());
        let said = printed(&output);
        assert!(said.contains("cargo xtask setup blender"), "{said}");
        assert!(!out.exists());
    }
}
