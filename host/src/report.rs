//! One HTML page that tells what was measured: facts, tables, charts and pictures in a single file without a network.

use std::fmt::Write as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

const STYLE: &str = include_str!("report/style.css");

/// A page under construction: blocks appear in the order in which they are added.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    title: String,
    blocks: Vec<Block>,
}

/// A picture and what it shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Content of a PNG file.
    pub png: Vec<u8>,
    /// A few words below it.
    pub caption: String,
}

#[derive(Debug, Clone, PartialEq)]
enum Block {
    Heading(String),
    Text(String),
    Facts(Vec<(String, String)>),
    Table { caption: String, header: Vec<String>, rows: Vec<Vec<String>> },
    Chart { svg: String, caption: String },
    Pictures { pictures: Vec<Picture>, caption: String },
}

impl Report {
    /// An empty page.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), blocks: Vec::new() }
    }

    /// Starts a section.
    pub fn heading(&mut self, text: impl Into<String>) -> &mut Self {
        self.add(Block::Heading(text.into()))
    }

    /// A paragraph of plain text.
    pub fn text(&mut self, text: impl Into<String>) -> &mut Self {
        self.add(Block::Text(text.into()))
    }

    /// Names with their values.
    pub fn facts<N: Into<String>, V: Into<String>>(
        &mut self,
        facts: impl IntoIterator<Item = (N, V)>,
    ) -> &mut Self {
        self.add(Block::Facts(facts.into_iter().map(|(name, value)| (name.into(), value.into())).collect()))
    }

    /// A table; columns whose cells are all numbers are aligned to the right, and a cell that a row lacks shows a dash.
    pub fn table(
        &mut self,
        caption: impl Into<String>,
        header: &[&str],
        rows: Vec<Vec<String>>,
    ) -> &mut Self {
        let header = header.iter().map(|&name| name.into()).collect();
        self.add(Block::Table { caption: caption.into(), header, rows })
    }

    /// A chart as [`crate::chart`] draws it: `svg` is put into the page as it is.
    pub fn chart(&mut self, svg: impl Into<String>, caption: impl Into<String>) -> &mut Self {
        self.add(Block::Chart { svg: svg.into(), caption: caption.into() })
    }

    /// Pictures side by side, such as photograph, reconstruction and difference; below each other on a narrow screen.
    pub fn pictures(&mut self, pictures: Vec<Picture>, caption: impl Into<String>) -> &mut Self {
        self.add(Block::Pictures { pictures, caption: caption.into() })
    }

    /// The page.
    pub fn to_html(&self) -> String {
        let title = escape(&self.title);
        let mut html = format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n"
        );
        for block in &self.blocks {
            html.push_str(&block.to_html());
        }
        html.push_str("</body>\n</html>\n");
        html
    }

    fn add(&mut self, block: Block) -> &mut Self {
        self.blocks.push(block);
        self
    }
}

impl Block {
    fn to_html(&self) -> String {
        match self {
            Block::Heading(text) => format!("<h2>{}</h2>\n", escape(text)),
            Block::Text(text) => format!("<p>{}</p>\n", escape(text)),
            Block::Facts(facts) => {
                let row = |(name, value): &(String, String)| {
                    format!("<tr><th scope=\"row\">{}</th><td>{}</td></tr>\n", escape(name), escape(value))
                };
                let rows: String = facts.iter().map(row).collect();
                format!("<div class=\"wide\"><table class=\"facts\"><tbody>\n{rows}</tbody></table></div>\n")
            }
            Block::Table { caption, header, rows } => table(caption, header, rows),
            Block::Chart { svg, caption } => {
                // Inside a page the name of SVG's language is known, and it looks like an address to a checker.
                let svg = svg.replacen(" xmlns=\"http://www.w3.org/2000/svg\"", "", 1);
                format!("<figure class=\"chart-figure\">\n{svg}\n{}</figure>\n", figcaption(caption))
            }
            Block::Pictures { pictures, caption } => {
                let picture = |picture: &Picture| {
                    format!(
                        "<figure><img alt=\"{}\" src=\"data:image/png;base64,{}\">{}</figure>\n",
                        escape(&picture.caption),
                        STANDARD.encode(&picture.png),
                        figcaption(&picture.caption)
                    )
                };
                let row: String = pictures.iter().map(picture).collect();
                format!("<figure>\n<div class=\"row\">\n{row}</div>\n{}</figure>\n", figcaption(caption))
            }
        }
    }
}

fn table(caption: &str, header: &[String], rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).chain([header.len()]).max().unwrap_or(0);
    let cell = |row: &[String], column: usize| row.get(column).map_or("–".to_owned(), |text| escape(text));
    let class: Vec<&str> = (0..columns)
        .map(|column| {
            let mut cells = rows.iter().filter_map(|row| row.get(column)).peekable();
            let numbers = cells.peek().is_some() && cells.all(|text| is_number(text));
            if numbers { " class=\"number\"" } else { "" }
        })
        .collect();
    let mut html = String::from("<div class=\"wide\"><table>\n");
    if !caption.is_empty() {
        let _ = writeln!(html, "<caption>{}</caption>", escape(caption));
    }
    html.push_str("<thead><tr>");
    for (column, class) in class.iter().enumerate() {
        let name = header.get(column).map_or(String::new(), |name| escape(name));
        let _ = write!(html, "<th scope=\"col\"{class}>{name}</th>");
    }
    html.push_str("</tr></thead>\n<tbody>\n");
    for row in rows {
        html.push_str("<tr>");
        for (column, class) in class.iter().enumerate() {
            let _ = write!(html, "<td{class}>{}</td>", cell(row, column));
        }
        html.push_str("</tr>\n");
    }
    html.push_str("</tbody></table></div>\n");
    html
}

/// A number, perhaps with a unit, a percent sign or an uncertainty behind it.
fn is_number(text: &str) -> bool {
    text.split_whitespace().next().is_some_and(|first| first.trim_end_matches('%').parse::<f64>().is_ok())
}

fn figcaption(text: &str) -> String {
    if text.is_empty() { String::new() } else { format!("<figcaption>{}</figcaption>\n", escape(text)) }
}

fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            other => escaped.push(other),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::{Axis, ChartPoint, scatter};

    fn sample() -> Report {
        let axis = Axis { label: "time & <error>", logarithmic: true };
        let point = ChartPoint { method: "SH".into(), x: 1.0, y: 2.0, label: "16".into() };
        let mut report = Report::new("Leather <\"1\"> & more");
        report.heading("What was <measured>").text("It's a & b.");
        report.facts([("views", "75"), ("scale <s>", "1 & 2")]);
        report.table(
            "per 'model'",
            &["model", "error"],
            vec![vec!["<phong>".into(), "0.1".into()], vec!["SH".into()]],
        );
        report.chart(scatter(&[point], (axis, axis)).unwrap(), "speed <against> accuracy");
        report.pictures(
            vec![Picture { png: b"\x89PNG<>".to_vec(), caption: "a \"photograph\"".into() }],
            "row",
        );
        report
    }

    /// Panics unless every tag that is opened is closed in order.
    fn assert_well_formed(html: &str) {
        let mut open: Vec<&str> = Vec::new();
        let start = html.find("<html").unwrap();
        // The style sheet is no markup, and holds a ">" or two.
        let mut rest = &html[start..];
        while let Some(at) = rest.find('<') {
            rest = &rest[at + 1..];
            let end = rest.find('>').expect("a tag ends");
            let tag = &rest[..end];
            assert!(!tag.contains('<'), "{tag}");
            assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
            rest = &rest[end + 1..];
            let name = tag.trim_start_matches('/').split([' ', '\n', '/']).next().unwrap();
            if tag.starts_with('/') {
                assert_eq!(open.pop(), Some(name), "{tag} closes another");
            } else if !tag.ends_with('/') && !["meta", "img"].contains(&name) {
                open.push(name);
            }
            if name == "style" && !tag.starts_with('/') {
                rest = &rest[rest.find("</style>").unwrap()..];
            }
        }
        assert!(open.is_empty(), "{open:?} stay open");
    }

    #[test]
    fn the_page_is_well_formed_and_its_text_escaped() {
        let html = sample().to_html();
        assert_well_formed(&html);
        for text in [
            "Leather &lt;&quot;1&quot;&gt; &amp; more",
            "What was &lt;measured&gt;",
            "It&#39;s a &amp; b.",
            "scale &lt;s&gt;",
            "&lt;phong&gt;",
            "per &#39;model&#39;",
            "speed &lt;against&gt; accuracy",
        ] {
            assert!(html.contains(text), "{text} is missing");
        }
        assert!(!html.contains("<phong>") && !html.contains("<error>"));
    }

    #[test]
    fn the_page_needs_no_network() {
        let html = sample().to_html();
        assert!(!html.contains("http") && !html.contains("url(") && !html.contains("@import"));
        for source in html.split("src=\"").skip(1).chain(html.split("href=\"").skip(1)) {
            assert!(source.starts_with("data:image/png;base64,"), "{}", &source[..40]);
        }
        let encoded = html.split("base64,").nth(1).unwrap().split('"').next().unwrap();
        assert_eq!(STANDARD.decode(encoded).unwrap(), b"\x89PNG<>");
    }

    #[test]
    fn columns_of_numbers_are_aligned_and_missing_cells_shown() {
        let html = sample().to_html();
        assert!(html.contains("<th scope=\"col\" class=\"number\">error</th>"));
        assert!(html.contains("<td>&lt;phong&gt;</td><td class=\"number\">0.1</td>"));
        assert!(html.contains("<td>SH</td><td class=\"number\">–</td>"));
        assert!(["1", "-2.5e-3", "3 ms", "12%", "1.5 ± 0.1"].into_iter().all(is_number));
        assert!(!["SH 16", "", "n/a"].into_iter().any(is_number));
    }
}
