//! Files that appear whole or not at all: written under a hidden name in the
//! same folder, synced, renamed. An interrupted program leaves the old file.

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use tempfile::NamedTempFile;

use crate::error::{DatasetError, Result};

/// A temporary file in the folder of `path`, so that renaming stays on one
/// disk; removed when dropped.
pub(crate) fn temporary_beside(path: &Path) -> Result<NamedTempFile> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".drape-").suffix(".partial");
    #[cfg(unix)]
    {
        // Readable like any other file (the umask applies), not private to the user.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder
        .tempfile_in(folder)
        .map_err(DatasetError::io("create a file in", folder))
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
