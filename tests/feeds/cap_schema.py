"""CAP 1.2 as its standard words it: the order, the values and the forms of what queuetail sends.

Written from OASIS CAP-v1.2-os (1 July 2010), section 3.2 (data dictionary) and 3.3.2 (times); the
elements that queuetail never sends are left out, so that sending one is an error.
"""

from __future__ import annotations

import re

from lxml import etree

from queuetail.feeds.cap import NAMESPACE


def _values(*words: str) -> str:
    rows = "".join(f'<xs:enumeration value="{word}"/>' for word in words)
    return (
        f'<xs:simpleType><xs:restriction base="xs:string">{rows}</xs:restriction></xs:simpleType>'
    )


def _element(name: str, inner: str, least: int = 1) -> str:
    return f'<xs:element name="{name}" minOccurs="{least}">{inner}</xs:element>'


def _form(pattern: str) -> str:
    return (
        '<xs:simpleType><xs:restriction base="xs:string">'
        f'<xs:pattern value="{pattern}"/></xs:restriction></xs:simpleType>'
    )


TIME = _form(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[-+]\d\d:\d\d")
NAME = _form(r"[^\s,&lt;&amp;]+")
TEXT = _form(r"(.|\s)*\S(.|\s)*")
NUMBER = r"-?\d{1,3}(\.\d+)?"
SCHEMA = f"""<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema"
    targetNamespace="{NAMESPACE}" elementFormDefault="qualified">
  <xs:element name="alert"><xs:complexType><xs:sequence>
    {_element("identifier", NAME)}{_element("sender", NAME)}{_element("sent", TIME)}
    {_element("status", _values("Actual", "Exercise", "System", "Test", "Draft"))}
    {_element("msgType", _values("Alert", "Update", "Cancel", "Ack", "Error"))}
    {_element("source", TEXT, 0)}
    {_element("scope", _values("Public", "Restricted", "Private"))}
    {_element("restriction", TEXT, 0)}{_element("addresses", TEXT, 0)}
    {_element("note", TEXT, 0)}{_element("references", TEXT, 0)}
    <xs:element name="info"><xs:complexType><xs:sequence>
      {_element("language", _form("[a-z]{2}-[A-Z]{2}"))}
      {_element("category", _values("Safety", "Transport", "Infra", "Other"))}
      {_element("event", TEXT)}
      {_element("responseType", _values("Prepare", "Avoid", "Monitor", "AllClear", "None"))}
      {_element("urgency", _values("Immediate", "Expected", "Future", "Past", "Unknown"))}
      {_element("severity", _values("Extreme", "Severe", "Moderate", "Minor", "Unknown"))}
      {_element("certainty", _values("Observed", "Likely", "Possible", "Unlikely", "Unknown"))}
      {_element("effective", TIME)}{_element("onset", TIME)}{_element("expires", TIME)}
      {_element("senderName", TEXT)}{_element("headline", TEXT)}
      {_element("description", TEXT)}{_element("instruction", TEXT, 0)}
      <xs:element name="area"><xs:complexType><xs:sequence>
        {_element("areaDesc", TEXT)}
        {_element("circle", _form(f"{NUMBER},{NUMBER} [0-9]+([.][0-9]+)?"))}
      </xs:sequence></xs:complexType></xs:element>
    </xs:sequence></xs:complexType></xs:element>
  </xs:sequence></xs:complexType></xs:element>
</xs:schema>"""
REFERENCE = re.compile(r"[^\s,]+,[^\s,]+,\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[-+]\d\d:\d\d")


def check_alert(text: bytes) -> etree._Element:
    """Return an alert that follows the standard; raises where it does not."""
    root = etree.fromstring(text)
    etree.XMLSchema(etree.fromstring(SCHEMA)).assertValid(root)

    def value(name: str) -> str | None:
        return root.findtext(f".//{{{NAMESPACE}}}{name}")

    kind, scope, references = value("msgType"), value("scope"), value("references")
    assert (references is not None) == (kind in ("Update", "Cancel"))  # 3.2.1: references
    assert references is None or all(REFERENCE.fullmatch(r) for r in references.split())
    assert (value("restriction") is not None) == (scope == "Restricted")
    assert scope != "Private" or value("addresses") is not None
    assert str(value("expires")) > str(value("sent"))
    return root
