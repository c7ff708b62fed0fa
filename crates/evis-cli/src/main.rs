//! `evis-rs`.

fn main() -> std::process::ExitCode {
    let code = evis_cli::run(std::env::args().collect());
    std::process::ExitCode::from(u8::try_from(code).unwrap_or(1))
}
