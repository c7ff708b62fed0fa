//! `compare`: two recordings' statistics side by side.

use std::path::Path;

use evis_chart::PictureKind;
use evis_core::stats::{Comparison, Named, stats};

use crate::args::CompareArgs;
use crate::outputs::check_parent;
use crate::{extent, text};

/// Counts, prints and draws.
pub(crate) fn compare(args: &CompareArgs) -> anyhow::Result<i32> {
    if let Some(output) = &args.output {
        PictureKind::of(output)?;
        check_parent(output, "--output")?;
    }
    let side = |path: &Path| -> anyhow::Result<Named> {
        let file = extent::part(path, args.camera.as_deref(), args.start, args.duration)?;
        let counted = stats(&file.events, file.size, file.range)?;
        Ok(Named { name: path.display().to_string(), stats: counted })
    };
    let comparison = Comparison { a: side(&args.a)?, b: side(&args.b)? };
    if args.json {
        // The table has them.
        for note in comparison.notes() {
            text::complain(&format!("note: {note}"));
        }
        text::say_json(&comparison)?;
    } else {
        text::say(&comparison.to_string());
    }
    if let Some(output) = &args.output {
        evis_chart::compare::save(&comparison, output)?;
        if !args.json {
            text::say(&format!("{}", output.display()));
        }
    }
    Ok(0)
}
