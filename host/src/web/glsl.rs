//! The shader in the language of browsers.

use naga::back::glsl::{Options, PipelineOptions, Version, Writer, WriterFlags};
use naga::{ShaderStage, back, front, proc, valid};

use crate::shader::{Stored, source};
use crate::{Error, Result};

/// The vertex shader.
pub(super) fn vertex(models: &[Stored]) -> Result<String> {
    translated(models, ShaderStage::Vertex, "everywhere")
}

/// One of the fragment shaders.
pub(super) fn program(models: &[Stored], fragment: &str) -> Result<String> {
    translated(models, ShaderStage::Fragment, fragment)
}

fn translated(models: &[Stored], shader_stage: ShaderStage, entry: &str) -> Result<String> {
    let failed = |what: String| {
        Error::request(format!("the shader {entry} cannot be translated: {what}"), "report this as a bug")
    };
    let text = source(models);
    let module = front::wgsl::parse_str(&text).map_err(|error| failed(error.emit_to_string(&text)))?;
    let mut validator =
        valid::Validator::new(valid::ValidationFlags::all(), valid::Capabilities::SHADER_FLOAT16_IN_FLOAT32);
    let info = validator.validate(&module).map_err(|error| failed(error.emit_to_string(&text)))?;
    let options = Options {
        version: Version::Embedded { version: 300, is_webgl: true },
        writer_flags: WriterFlags::empty(),
        ..Options::default()
    };
    let pipeline = PipelineOptions { shader_stage, entry_point: entry.into(), multiview: None };
    let mut written = String::new();
    let policies = proc::BoundsCheckPolicies::default();
    Writer::new(&mut written, &module, &info, &options, &pipeline, policies)
        .and_then(|mut writer| writer.write())
        .map_err(|error: back::glsl::Error| failed(error.to_string()))?;
    Ok(written)
}
