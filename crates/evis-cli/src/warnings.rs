//! Warnings of a run.

use crate::{options, text};

/// Warnings: to the user at once, and to the report.
#[derive(Default)]
pub(crate) struct Warnings(pub(crate) Vec<String>);

impl Warnings {
    pub(crate) fn add(&mut self, warning: String) {
        let warning = options::in_text(&warning);
        if !self.0.contains(&warning) {
            text::complain(&format!("warning: {warning}"));
            self.0.push(warning);
        }
    }
}
