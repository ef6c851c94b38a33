//! Compiles the message definitions with a protobuf compiler written in Rust, so that no `protoc` need be installed.

use anyhow::Context;

fn main() -> anyhow::Result<()> {
    println!("cargo::rerun-if-changed=proto");
    let descriptors =
        protox::compile(["proto/lodestone.proto"], ["proto"]).context("compiling proto/lodestone.proto")?;
    // The generated types are an implementation detail of the codec; the comments that matter are in the .proto file.
    prost_build::Config::new()
        .disable_comments(["."])
        .compile_fds(descriptors)
        .context("generating Rust code from proto/lodestone.proto")?;
    Ok(())
}
