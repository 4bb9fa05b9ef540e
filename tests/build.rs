//! Sets the cfg `shared` where `LUMISCAN_SHARED` names the folder of shared test data: tests that need it are reported as
//! ignored without it, by `#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: …")]`. The crate `capture`, whose
//! package the end-to-end tests belong to, runs this script too.

/// Sets the cfg.
pub fn main() {
    println!("cargo:rustc-check-cfg=cfg(shared)");
    println!("cargo:rerun-if-env-changed=LUMISCAN_SHARED");
    if std::env::var_os("LUMISCAN_SHARED").is_some() {
        println!("cargo:rustc-cfg=shared");
    }
}
