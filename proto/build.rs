//! Compiles the protobuf definitions with a compiler written in Rust, so that the build does not need `protoc`.

use anyhow::Context;

fn main() -> anyhow::Result<()> {
    println!("cargo::rerun-if-changed=proto");
    let descriptors =
        protox::compile(["proto/lodestone.proto"], ["proto"]).context("compiling proto/lodestone.proto")?;
    // The generated types are private to the codec; the comments in the .proto file are the reference.
    prost_build::Config::new()
        .disable_comments(["."])
        // Every actor decodes these megabytes, so the message keeps a slice of the received buffer instead of a copy.
        .bytes([".lodestone.v1.Weights.parameters"])
        .compile_fds(descriptors)
        .context("generating Rust code from proto/lodestone.proto")?;
    Ok(())
}
