//! `rigel chart`: the sweeps of the atlas, on one page.

use rigel::report::Report;
use rigel::{Error, Result, file};
use rigel_atlas::Peers;

use crate::arguments::Chart;
use crate::progress::Bar;
use crate::say::say;
use crate::verbs::NewFolders;

/// `rigel chart`.
pub fn chart(arguments: &Chart) -> Result<()> {
    let peers = arguments.peers.as_deref().map_or_else(|| Ok(Peers::default()), Peers::read)?;
    let out = &arguments.out;
    let _new = NewFolders::below(out);
    std::fs::create_dir_all(out).map_err(Error::io("create", out))?;
    let mut report = Report::new("Rigel: speed, accuracy, and where it breaks");
    report.text(
        "Every figure was measured by `rigel chart` on simulated data whose truth is known. The charts are beside this page as SVG, the figures as CSV \
         with the machine in front.",
    );
    report.facts(rigel_atlas::facts());
    rigel_atlas::radiance(out, &mut report, &Bar::new("radiance"))?;
    rigel_atlas::lens(out, &mut report, &Bar::new("lens"))?;
    rigel_atlas::poses(out, &mut report, &Bar::new("poses"))?;
    rigel_atlas::fit(out, &peers, &mut report, &Bar::new("fit"))?;
    rigel_atlas::mosaic(out, &mut report, &Bar::new("mosaic"))?;
    rigel_atlas::environment(out, &mut report, &Bar::new("environment"))?;
    rigel_atlas::lights(out, &mut report, &Bar::new("lights"))?;
    let page = out.join("index.html");
    file::write_bytes(&page, report.to_html().as_bytes())?;
    say!("wrote {}: open {} in a browser", out.display(), page.display());
    Ok(())
}
