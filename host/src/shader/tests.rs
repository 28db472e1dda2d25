use super::*;
use crate::fit::Model;

#[test]
fn the_text_for_every_model_is_valid() {
    let stored = |is_wide| Model::all().into_iter().map(move |model| Stored { model, is_wide });
    for one in stored(false).chain(stored(true)) {
        validate(&source(&[one]), &one.model.name());
    }
    validate(&source(&stored(false).collect::<Vec<_>>()), "all");
}

fn validate(text: &str, name: &str) {
    let module = naga::front::wgsl::parse_str(text)
        .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(text)));
    let capabilities = naga::valid::Capabilities::SHADER_FLOAT16_IN_FLOAT32;
    let mut validator = naga::valid::Validator::new(naga::valid::ValidationFlags::all(), capabilities);
    validator.validate(&module).unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(text)));
}
