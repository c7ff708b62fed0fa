//! `evis-rs`.

fn main() -> std::process::ExitCode {
    // Mesa's drivers complain where this is missing, as in containers; nothing of ours is put there.
    if cfg!(target_os = "linux") && std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        // SAFETY: no other thread runs yet.
        unsafe { std::env::set_var("XDG_RUNTIME_DIR", std::env::temp_dir()) };
    }
    let code = evis_cli::run(std::env::args().collect());
    std::process::ExitCode::from(u8::try_from(code).unwrap_or(1))
}
