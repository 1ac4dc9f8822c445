//! Files that appear whole or not at all: written under a hidden name in the
//! same folder, synced, renamed. An interrupted program leaves the old file.
//!
//! A program that is killed leaves its hidden file too, `.NAME-XXXXXX.partial`; whoever
//! writes NAME next takes it away, so that they do not pile up. A writer holds a lock on
//! its hidden file, which ends with the writer, however that ends: only files that
//! nobody writes to are taken away.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

use tempfile::NamedTempFile;

use crate::error::{DatasetError, Result};

const SUFFIX: &str = ".partial";
/// Random characters in a hidden name.
const RANDOM: usize = 6;
/// Longer names would not leave room for prefix, random part and suffix in the 255 bytes
/// that file systems allow; their hidden files get a name without them.
const LONGEST_NAME: usize = 200;

/// A temporary file in the folder of `path`, so that renaming stays on one
/// disk; removed when dropped. Those that killed writers of `path` left are removed.
pub(crate) fn temporary_beside(path: &Path) -> Result<NamedTempFile> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let name = path.file_name().and_then(OsStr::to_str);
    let name = name.filter(|name| name.len() <= LONGEST_NAME);
    let prefix = format!(".{}-", name.unwrap_or("drape"));
    if name.is_some() {
        remove_abandoned(folder, &prefix);
    }
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(SUFFIX).rand_bytes(RANDOM);
    #[cfg(unix)]
    {
        // Readable like any other file (the umask applies), not private to the user.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    loop {
        let file = builder
            .tempfile_in(folder)
            .map_err(DatasetError::io("create a file in", folder))?;
        // Where there are no locks, nobody can take the file away either.
        file.as_file().lock().ok();
        // Another writer of the same name may have taken it away before it was locked.
        if file.path().exists() {
            return Ok(file);
        }
    }
}

/// Removes hidden files of this prefix that nobody writes to. What cannot be read, locked
/// or removed stays: it is in nobody's way.
fn remove_abandoned(folder: &Path, prefix: &str) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let random = name.to_str().and_then(|name| name.strip_prefix(prefix));
        let random = random.and_then(|rest| rest.strip_suffix(SUFFIX));
        if random.is_none_or(|random| random.len() != RANDOM) {
            continue;
        }
        // Locked until it is gone: who has just made it, and not locked it yet, then sees so.
        if let Ok(file) = File::open(entry.path())
            && file.try_lock().is_ok()
        {
            fs::remove_file(entry.path()).ok();
        }
    }
}

/// Makes `file` durable under the name `path`, replacing a file of that name.
pub(crate) fn persist(file: NamedTempFile, path: &Path) -> Result<()> {
    let io = |error: io::Error| DatasetError::io("write", path)(error);
    file.as_file().sync_all().map_err(io)?;
    file.persist(path).map_err(|error| io(error.error))?;
    // The rename itself is durable once the folder is; not every system can sync one.
    if let Some(Ok(folder)) = path.parent().map(File::open) {
        folder.sync_all().ok();
    }
    Ok(())
}

/// Writes a small file in one go.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    let mut file = temporary_beside(path)?;
    file.write_all(bytes)
        .map_err(DatasetError::io("write", path))?;
    persist(file, path)
}
