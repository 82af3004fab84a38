defmodule MavCodec.Definition.Importer.XMLTest do
  use ExUnit.Case, async: true

  alias MavCodec.Definition.Importer.XML

  test "elements, attributes in either quotes, text, and the line where each start tag ends" do
    assert XML.parse(~s(<a x="1"\n  y='2'>\n<b/>t</a>)) ==
             {:ok,
              {:element, "a", [{"x", "1"}, {"y", "2"}],
               [{:text, "\n", 2}, {:element, "b", [], [], 3}, {:text, "t", 3}], 2}}
  end

  test "declaration, byte order mark, comments and processing instructions are passed over, lines counted" do
    xml =
      "\uFEFF<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<!-- one\n< two & -->\n<?pi\n?><a><!-- - --><?x?></a>\n<!--end-->\n"

    assert XML.parse(xml) == {:ok, {:element, "a", [], [], 5}}
  end

  test "entities, character references and CDATA become text" do
    assert {:ok, root} = XML.parse("<a q='&quot;&#65;'>&lt;x&gt; &amp;&apos;&#x20AC;<![CDATA[<b>&amp;]]></a>")
    assert {:element, "a", [{"q", "\"A"}], _children, 1} = root
    assert XML.text(root) == "<x> &'€<b>&amp;"
  end

  # The reasons after "not XML" are the parser's own.
  for {what, xml, line, reason} <- [
        {"nothing", "", 1, "no element"},
        {"only text", "hello", 1, "not XML: "},
        {"an open element", "<a>\n<b>\n</b>", 3, "<a> is not closed"},
        {"crossed elements", "<a>\n<b></a></b>", 2, "expected </b>"},
        {"two roots", "<a/>\n<b/>", 2, "text after the root element"},
        {"an open tag", "<a x='1'", 1, "the file ends in the middle"},
        {"an open attribute", "<a x='1>", 1, "the file ends in the middle"},
        {"an attribute without value", "<a x>", 1, "not XML: "},
        {"an attribute without quotes", "<a x=1>", 1, "not XML: "},
        {"an attribute twice", "<a x='1'\nx='2'/>", 2, "not XML: "},
        {"attributes not separated", "<a x='1'y='2'/>", 1, "not XML: "},
        {"< in a value", "<a x='<'/>", 1, "not XML: "},
        {"an open comment", "<a>\n\n<!-- </a>", 3, "<a> is not closed"},
        {"a bare &", "<a>x\n & y</a>", 2, "not XML: "},
        {"a character that is none", "<a>&#0;</a>", 1, "not XML: "},
        {"a document type, whose files would be read", "<!DOCTYPE a SYSTEM 'file:///etc/passwd'>\n<a/>", 1,
         "a document type declaration is not accepted"},
        {"entities of its own", "<!DOCTYPE a [<!ENTITY b 'c'>]>\n<a/>", 1,
         "a document type declaration is not accepted"},
        {"a declaration inside", "<a><!ELEMENT b></a>", 1, "not XML: "},
        {"another encoding", "<?xml version='1.0' encoding='latin1'?><a/>", 1, "encoding latin1: not UTF-8"},
        {"bytes that are not UTF-8", "<a>\n\xFF</a>", 2, "not UTF-8"},
        {"UTF-16", :unicode.characters_to_binary("<a/>", :utf8, :utf16), 1, "not UTF-8"},
        {"a bad name", "<1/>", 1, "not XML: "},
        {"deep nesting", String.duplicate("<a>", 17), 1, "elements nested deeper than 16"}
      ] do
    test "refuses #{what}" do
      assert {:error, unquote(line), unquote(reason) <> _more} = XML.parse(unquote(xml))
    end
  end

  test "accepts nesting up to the limit" do
    assert {:ok, _root} = XML.parse(String.duplicate("<a>", 16) <> String.duplicate("</a>", 16))
  end

  test "makes no atoms of names and texts" do
    parts = for n <- 1..200, into: "", do: "<unseen_#{n} other_#{n}='value_#{n}'>text_#{n}</unseen_#{n}>"
    xml = "<a>#{parts}</a>"
    assert {:ok, _root} = XML.parse("<a/>")
    assert {:ok, _root} = XML.parse(xml)
    for name <- ~w(unseen_7 other_7 value_7 text_7), do: refute(atom?(name))
  end

  defp atom?(name) do
    _atom = String.to_existing_atom(name)
    true
  rescue
    ArgumentError -> false
  end

  test "refuses what is too large" do
    assert {:error, nil, "larger than" <> _} = XML.parse(String.duplicate(" ", 4 * 1024 * 1024 + 1))
  end

  test "any bytes: a result, never an exception" do
    pieces =
      ~w(< > / a = ' " & ; # !-- --> <![CDATA[ ]]> ? <a> </a> &# xD800; &lt; <!DOCTYPE <?pi) ++
        [" ", "\n", "\uFFFE"]

    property =
      :proper.forall(:proper_types.list(:proper_types.oneof(pieces)), fn list ->
        case XML.parse("<a>#{list}</a>") do
          {:ok, {:element, _, _, _, _}} -> true
          {:error, _line, reason} -> is_binary(reason)
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 2_000]) == true, inspect(:proper.counterexample())
  end
end
