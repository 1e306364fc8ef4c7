//! XML, event by event.

use quick_xml::XmlVersion;
use quick_xml::events::{BytesDecl, Event};
use std::collections::BTreeMap;

/// The events of an XML text. One that ends within an element is an error: it has been cut off. So is one with a
/// document type: its entities could hold elements that only SUMO sees.
pub struct Events<'a> {
    reader: quick_xml::Reader<&'a [u8]>,
    open: usize,
}

impl<'a> Events<'a> {
    pub fn of(text: &'a str) -> Self {
        Self { reader: quick_xml::Reader::from_str(text), open: 0 }
    }

    pub fn next(&mut self) -> Result<Event<'a>, String> {
        let event = self.reader.read_event();
        let event = event.map_err(|e| format!("{e} (at byte {})", self.reader.error_position()))?;
        match event {
            Event::Start(_) => self.open += 1,
            Event::End(_) => self.open = self.open.saturating_sub(1),
            Event::Eof if self.open > 0 => return Err("it is cut off before its end".to_string()),
            // The text is in UTF-8 by now, and so will be what is written of it.
            Event::Decl(_) => return Ok(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None))),
            Event::DocType(_) => return Err("it declares a document type (<!DOCTYPE>)".to_string()),
            _ => {}
        }
        Ok(event)
    }
}

/// Calls `visit` with each element's name and attributes.
pub fn for_each_element(
    text: &str,
    mut visit: impl FnMut(&str, &BTreeMap<String, String>),
) -> Result<(), String> {
    let mut reader = Events::of(text);
    let mut elements = 0usize;
    loop {
        match reader.next()? {
            Event::Eof => break,
            Event::Start(start) | Event::Empty(start) => {
                elements += 1;
                let mut attributes = BTreeMap::new();
                for attribute in start.attributes() {
                    let attribute = attribute.map_err(|e| e.to_string())?;
                    let value =
                        attribute.normalized_value(XmlVersion::Implicit1_0).map_err(|e| e.to_string())?;
                    attributes.insert(attribute.key.0.to_string(), value.into_owned());
                }
                visit(start.name().0, &attributes);
            }
            _ => {}
        }
    }
    if elements == 0 { Err("it holds no XML element".to_string()) } else { Ok(()) }
}
