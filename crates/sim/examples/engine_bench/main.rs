//! How fast is the cloth engine? Processor time per frame, beside what makes
//! it worth anything: strain, and intersections counted in every frame.
//!
//! `cargo run --release -p drape-sim --example engine_bench -- --help`

mod refine;
mod scene;

use anyhow::{Context, Result, ensure};
use clap::{Parser, ValueEnum};
use cpu_time::ThreadTime;
use drape_dataset::registry::Effect;
use drape_geometry::intersect::{count_between, count_within};
use drape_geometry::mesh::edges;
use drape_geometry::vector::distance2;
use drape_sim::engine::profile::{self, Part, Profile};
use drape_sim::engine::{Engine, EngineSettings};

use scene::{FPS, Scene, Wardrobe};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Time the cloth engine on scenes of known size, one thread.
///
/// A body of 13,380 vertices walks in wind. Every measured frame is checked:
/// edge strain, intersections of garments with each other, themselves, the body.
/// Leave the machine alone meanwhile.
#[derive(Parser)]
struct Arguments {
    /// What to run
    #[arg(long, value_enum, default_value = "outfits")]
    scene: Which,
    /// Measured frames of each run
    #[arg(long, default_value_t = 60)]
    frames: usize,
    /// Wind, in the paper's units
    #[arg(long, default_value_t = 200.0)]
    wind: f32,
    /// Speed of the walk; 1 is a step in 0.6 s
    #[arg(long, default_value_t = 0.75)]
    pace: f64,
    /// Engine settings that differ from the defaults, as TOML: 'substeps = 12'
    #[arg(long, value_name = "TOML", default_value = "")]
    engine: String,
    /// Smallest and largest outfit of the growth runs, vertices
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "1000,2000,4000,8000,16000,32000,64000"
    )]
    sizes: Vec<usize>,
    /// Print where the time goes, effect by effect
    #[arg(long)]
    profile: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Which {
    /// T-shirt and jacket of 9,600 vertices, then two skirts of 2,000
    Outfits,
    /// T-shirt and jacket
    Jacket,
    /// Two skirts
    Skirts,
    /// T-shirt and jacket of growing size, the body's cost apart
    Growth,
}

const BODY_VERTICES: usize = 13_380;

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    ensure!(
        arguments.frames > 0,
        "--frames: expected at least 1, found 0"
    );
    let settings: EngineSettings = toml::from_str(&arguments.engine)
        .with_context(|| format!("--engine: {:?} is no engine settings", arguments.engine))?;
    settings.validate()?;
    println!("processor time, {} frames a run", arguments.frames);
    let scene = |wardrobe, vertices| {
        Scene::new(
            wardrobe,
            vertices,
            BODY_VERTICES,
            arguments.frames,
            arguments.pace,
            arguments.wind,
        )
    };
    let single = |name: &str, wardrobe, vertices| -> Result<()> {
        let run = run(&scene(wardrobe, vertices)?, &settings, arguments.profile)?;
        run.print(name);
        Ok(())
    };
    match arguments.scene {
        Which::Outfits | Which::Jacket | Which::Skirts => {
            if arguments.scene != Which::Skirts {
                single("T-shirt + jacket", Wardrobe::Jacket, 9_600)?;
            }
            if arguments.scene != Which::Jacket {
                single("two skirts", Wardrobe::Skirts, 2_000)?;
            }
        }
        Which::Growth => {
            let mut points = Vec::new();
            for &vertices in &arguments.sizes {
                // Keeping time takes time itself: one run for the time, one for the shares.
                let scene = scene(Wardrobe::Jacket, vertices)?;
                let mut run = self::run(&scene, &settings, false)?;
                run.profile = self::run(&scene, &settings, true)?.profile;
                run.print(&format!("growth, {vertices}"));
                points.push((run.vertices as f64, run.cloth_s()));
            }
            for pair in points.windows(2) {
                let [(n, t), (m, u)] = [pair[0], pair[1]];
                println!(
                    "{n:.0} to {m:.0} vertices: time grows as n^{:.2}",
                    (u / t).ln() / (m / n).ln()
                );
            }
            if let (Some((n, t)), Some((m, u))) = (points.first(), points.last()) {
                println!("in all: n^{:.2}", (u / t).ln() / (m / n).ln());
            }
        }
    }
    Ok(())
}

/// What one run showed.
struct Run {
    vertices: usize,
    body_vertices: usize,
    /// Processor time of each measured frame.
    seconds: Vec<f64>,
    /// 95th percentile of |length / rest − 1| of each frame, and of what is longer than at rest.
    strain: Vec<f64>,
    stretch: Vec<f64>,
    hits: [u32; 3],
    dirty_frames: usize,
    uncertified: u64,
    repaired: u64,
    searches: u64,
    pairs: usize,
    profile: Option<Profile>,
}

fn run(scene: &Scene, settings: &EngineSettings, with_profile: bool) -> Result<Run> {
    let make = || {
        Engine::new(
            &scene.garments,
            &scene.waistbands,
            &scene.body_faces,
            &scene.bodies[0],
            &scene.physics,
            settings,
        )
    };
    if !with_profile {
        let mut engine = make()?;
        lead_in(scene, &mut engine)?;
        return measured(scene, &mut engine);
    }
    // An engine keeps time if it was made within a recording; what leads in is in none.
    let (engine, _) = profile::recorded(make);
    let mut engine = engine?;
    lead_in(scene, &mut engine)?;
    let (run, profile) = profile::recorded(|| measured(scene, &mut engine));
    let mut run = run?;
    run.profile = Some(profile);
    Ok(run)
}

fn lead_in(scene: &Scene, engine: &mut Engine) -> Result<()> {
    for body in &scene.bodies[..scene.lead] {
        engine.advance(body, scene.wind, 1.0 / FPS)?;
    }
    Ok(())
}

fn measured(scene: &Scene, engine: &mut Engine) -> Result<Run> {
    let mut run = Run {
        vertices: scene.vertices(),
        body_vertices: scene.bodies[0].len(),
        seconds: Vec::new(),
        strain: Vec::new(),
        stretch: Vec::new(),
        hits: [0; 3],
        dirty_frames: 0,
        uncertified: 0,
        repaired: 0,
        searches: 0,
        pairs: 0,
        profile: None,
    };
    for body in &scene.bodies[scene.lead..] {
        let clock = ThreadTime::now();
        let report = engine.advance(body, scene.wind, 1.0 / FPS)?;
        run.seconds.push(clock.elapsed().as_secs_f64());
        run.uncertified += report.uncertified;
        run.repaired += report.repaired;
        run.searches += u64::from(report.searches);
        run.pairs = run.pairs.max(report.pairs);
        let positions = engine.garments();
        let (strain, stretch) = strains(scene, &positions);
        run.strain.push(strain);
        run.stretch.push(stretch);
        let hits = count(scene, &positions, body);
        run.dirty_frames += usize::from(hits != [0; 3]);
        for (sum, hits) in run.hits.iter_mut().zip(hits) {
            *sum += hits;
        }
    }
    Ok(run)
}

impl Run {
    /// Share of the time that pairs and contacts with the body take, as far as a profile tells.
    fn body_share(&self) -> Option<f64> {
        let profile = self.profile.as_ref()?;
        let bodys = |part: &Part| {
            matches!(
                part,
                Part::Search(Effect::BodyContact)
                    | Part::Narrow(Effect::BodyContact)
                    | Part::Solve(Effect::BodyContact)
            )
        };
        let of_body: f64 = profile
            .parts
            .iter()
            .filter(|(part, _)| bodys(part))
            .map(|(_, spent)| spent.time.as_secs_f64())
            .sum();
        // The profile's times are on the wall: their share is what counts.
        Some(of_body / profile.total.as_secs_f64().max(f64::MIN_POSITIVE))
    }

    /// Time per frame without pairs and contacts with the body; the whole time without a profile.
    fn cloth_s(&self) -> f64 {
        mean(&self.seconds) * (1.0 - self.body_share().unwrap_or(0.0))
    }

    fn print(&self, name: &str) {
        let ms = |s: f64| 1e3 * s;
        let mut sorted = self.seconds.clone();
        sorted.sort_by(f64::total_cmp);
        let worst = |x: &[f64]| x.iter().copied().fold(0.0, f64::max);
        println!(
            "\n{name}: {} garment and {} body vertices",
            self.vertices, self.body_vertices
        );
        println!(
            "  time           {:.1} ms/frame (median {:.1}, worst {:.1})",
            ms(mean(&self.seconds)),
            ms(sorted[sorted.len() / 2]),
            ms(worst(&self.seconds))
        );
        if self.body_share().is_some() {
            let rest = ms(self.cloth_s());
            println!(
                "  of that        {rest:.1} ms/frame without pairs and contacts with the body"
            );
        }
        println!(
            "  strain         {:.2} % in the mean frame, {:.2} % in the worst (95th percentile of edges); \
             stretch alone {:.2} %, {:.2} %",
            100.0 * mean(&self.strain),
            100.0 * worst(&self.strain),
            100.0 * mean(&self.stretch),
            100.0 * worst(&self.stretch)
        );
        let [between, within, body] = self.hits;
        println!(
            "  intersections  {between} between garments, {within} within, {body} with the body; \
             {} of {} frames dirty",
            self.dirty_frames,
            self.seconds.len()
        );
        println!(
            "  contacts       {:.1} searches/frame, up to {} pairs, {} repaired, {} uncertified",
            self.searches as f64 / self.seconds.len() as f64,
            self.pairs,
            self.repaired,
            self.uncertified
        );
        if let Some(profile) = &self.profile {
            println!("\n{profile}");
        }
    }
}

fn mean(x: &[f64]) -> f64 {
    x.iter().sum::<f64>() / x.len() as f64
}

fn strains(scene: &Scene, positions: &[Vec<[f32; 3]>]) -> (f64, f64) {
    let mut strain = Vec::new();
    let mut stretch = Vec::new();
    for (x, garment) in positions.iter().zip(&scene.garments) {
        for [a, b] in edges(&garment.faces) {
            let (a, b) = (a as usize, b as usize);
            let length = |x: &[[f32; 3]]| f64::from(distance2(x[a], x[b])).sqrt();
            let error = length(x) / length(&garment.rest) - 1.0;
            strain.push(error.abs());
            stretch.push(error.max(0.0));
        }
    }
    let percentile = |mut x: Vec<f64>| {
        let at = x.len() * 95 / 100;
        *x.select_nth_unstable_by(at, f64::total_cmp).1
    };
    (percentile(strain), percentile(stretch))
}

fn count(scene: &Scene, positions: &[Vec<[f32; 3]>], body: &[[f32; 3]]) -> [u32; 3] {
    let mut hits = [0; 3];
    for (i, (x, garment)) in positions.iter().zip(&scene.garments).enumerate() {
        for (y, other) in positions.iter().zip(&scene.garments).skip(i + 1) {
            hits[0] += count_between(x, &garment.faces, y, &other.faces);
        }
        hits[1] += count_within(x, &garment.faces);
        hits[2] += count_between(x, &garment.faces, body, &scene.body_faces);
    }
    hits
}
