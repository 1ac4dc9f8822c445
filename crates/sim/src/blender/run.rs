//! Blender at work on one sequence: a process that is given files and prints
//! a line for each frame it has written.

use std::fs::{self, File};
use std::io::{BufRead, BufReader, Lines};
use std::process::{Child, ChildStdout, Command, Stdio};

use tempfile::TempDir;

use super::job::Job;
use super::materials::SharedMaterials;
use super::python::Blender;
use crate::error::{Result, SimError};

const SCRIPT: &str = include_str!("../../blender/simulate.py");
/// What Blender says besides frames.
const LOG: &str = "blender.log";

/// A simulation going on in Blender; it ends when this is dropped.
pub struct Run {
    folder: TempDir,
    child: Child,
    lines: Lines<BufReader<ChildStdout>>,
    /// Vertices of each garment.
    counts: Vec<usize>,
    frame: usize,
    garments: Vec<Vec<[f32; 3]>>,
}

impl Run {
    pub(crate) fn start(blender: &Blender, job: &Job, shared: &SharedMaterials) -> Result<Self> {
        let failed = |what: &str, error: std::io::Error| {
            SimError::blender(format!("cannot {what}: {error}"))
        };
        let folder = tempfile::Builder::new()
            .prefix("drape-blender-")
            .tempdir()
            .map_err(|error| failed("make a temporary folder", error))?;
        job.write(folder.path(), shared)?;
        let script = folder.path().join("simulate.py");
        fs::write(&script, SCRIPT).map_err(|error| failed("write its script", error))?;
        let log = File::create(folder.path().join(LOG))
            .map_err(|error| failed("write its log", error))?;
        let mut command = Command::new(&blender.python);
        command
            .arg(&script)
            .arg(folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(log);
        // Ctrl-C is for this program, which ends Blender in its own time.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command
            .spawn()
            .map_err(|error| failed(&format!("start {}", blender.python.display()), error))?;
        let output = child.stdout.take().expect("stdout is piped");
        Ok(Self {
            folder,
            child,
            lines: BufReader::new(output).lines(),
            counts: job.garments.iter().map(|g| g.rest.len()).collect(),
            frame: 0,
            garments: job.garments.iter().map(|g| g.rest.clone()).collect(),
        })
    }

    /// Waits for the next frame.
    ///
    /// # Errors
    /// Blender ended, or wrote something else than the garments' vertices.
    pub fn advance(&mut self) -> Result<()> {
        let next = self.frame + 1;
        let done = format!("drape-frame {next}");
        loop {
            match self.lines.next() {
                Some(Ok(line)) if line == done => break,
                // Blender itself prints on the same channel.
                Some(Ok(_)) => {}
                Some(Err(error)) => return Err(self.ended(&error.to_string())),
                None => return Err(self.ended("it ended")),
            }
        }
        let path = self.folder.path().join(format!("frame_{next:05}.f32"));
        let bytes = fs::read(&path)
            .map_err(|error| SimError::blender(format!("cannot read frame {next}: {error}")))?;
        // Nobody needs the file any more; the folder goes at the end in any case.
        fs::remove_file(&path).ok();
        self.garments = parse(&bytes, &self.counts)
            .map_err(|reason| SimError::blender(format!("frame {next}: {reason}")))?;
        self.frame = next;
        Ok(())
    }

    /// Positions of each garment in the frame that was waited for last.
    pub fn garments(&self) -> Vec<Vec<[f32; 3]>> {
        self.garments.clone()
    }

    /// Why there is no next frame: what Blender said last.
    fn ended(&mut self, reason: &str) -> SimError {
        self.child.kill().ok();
        let status = match self.child.wait() {
            Ok(status) => status.to_string(),
            Err(error) => error.to_string(),
        };
        let log = fs::read(self.folder.path().join(LOG)).unwrap_or_default();
        let log = String::from_utf8_lossy(&log);
        let said: Vec<&str> = log
            .lines()
            .rev()
            .filter(|l| !l.is_empty())
            .take(3)
            .collect();
        let said = said.into_iter().rev().collect::<Vec<_>>().join(" | ");
        SimError::blender(format!(
            "{reason} after frame {} ({status}); its last words: {said}",
            self.frame
        ))
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        // Both fail only if it has ended already.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// Positions of all garments, one after the other, as Blender's merged mesh has them.
fn parse(bytes: &[u8], counts: &[usize]) -> Result<Vec<Vec<[f32; 3]>>, String> {
    let expected = 12 * counts.iter().sum::<usize>();
    if bytes.len() != expected {
        return Err(format!("expected {expected} bytes, found {}", bytes.len()));
    }
    let number = |four: &[u8]| f32::from_le_bytes([four[0], four[1], four[2], four[3]]);
    let mut rows = bytes
        .chunks_exact(12)
        .map(|row| [number(&row[..4]), number(&row[4..8]), number(&row[8..])]);
    let garment = |&count: &usize| rows.by_ref().take(count).collect();
    Ok(counts.iter().map(garment).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_come_back_garment_by_garment_and_a_short_file_is_refused() {
        let numbers: Vec<f32> = (0..9).map(|k| k as f32).collect();
        let mut bytes: Vec<u8> = numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
        let garments = parse(&bytes, &[1, 2]).unwrap();
        assert_eq!(garments[0], [[0.0, 1.0, 2.0]]);
        assert_eq!(garments[1], [[3.0, 4.0, 5.0], [6.0, 7.0, 8.0]]);
        bytes.pop();
        let reason = parse(&bytes, &[1, 2]).unwrap_err();
        assert_eq!(reason, "expected 36 bytes, found 35");
    }
}
