use super::*;
use crate::fit::Model;
use crate::shader::Stored;

#[test]
fn every_model_is_translated_for_browsers() {
    for model in Model::all() {
        for fragment in ["by_pixel", "shade_texel", "by_texel"] {
            let text = glsl::program(&[Stored { model, is_wide: false }], fragment).unwrap();
            assert!(text.starts_with("#version 300 es"), "{}", model.name());
        }
    }
    assert!(glsl::vertex(&[Stored { model: Model::Constant, is_wide: false }]).is_ok());
}
