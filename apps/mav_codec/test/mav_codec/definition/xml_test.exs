defmodule MavCodec.Definition.XMLTest do
  use ExUnit.Case, async: true

  alias MavCodec.Definition.XML

  test "elements, attributes in either quotes, text, and the line of each start tag" do
    assert XML.parse(~s(<a x="1"\n  y='2'>\n<b/>t</a>)) ==
             {:ok,
              {:element, "a", [{"x", "1"}, {"y", "2"}],
               [{:text, "\n", 2}, {:element, "b", [], [], 3}, {:text, "t", 3}], 1}}
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

  for {what, xml, line, reason} <- [
        {"nothing", "", 1, "no element"},
        {"only text", "hello", 1, "text outside of the root element"},
        {"an open element", "<a>\n<b>\n</b>", 3, "<a> of line 1 is not closed"},
        {"crossed elements", "<a>\n<b></a></b>", 2, "</a> closes <b> of line 2"},
        {"two roots", "<a/>\n<b/>", 2, "text after the root element"},
        {"an open tag", "<a x='1'", 1, "the tag is not closed"},
        {"an open attribute", "<a x='1>", 1, "the value of x does not end"},
        {"an attribute without value", "<a x>", 1, ~s(attribute x has no value: expected x="...")},
        {"an attribute without quotes", "<a x=1>", 1, ~s(attribute x has no value: expected x="...")},
        {"an attribute twice", "<a x='1'\nx='2'/>", 2, "attribute x given twice"},
        {"attributes not separated", "<a x='1'y='2'/>", 1, "expected a space or > after an attribute"},
        {"< in a value", "<a x='<'/>", 1, "< in the value of x"},
        {"an open comment", "<a>\n\n<!-- </a>", 3, "the comment does not end"},
        {"open CDATA", "<a><![CDATA[ </a>", 1, "the CDATA section does not end"},
        {"a bare &", "<a>x\n & y</a>", 2, "& that begins no entity (write &amp;)"},
        {"an unknown entity", "<a>&nbsp;</a>", 1, "unknown entity &nbsp;"},
        {"a character that is none", "<a>&#0;</a>", 1, "character 0 does not exist in XML"},
        {"a surrogate", "<a>&#xD800;</a>", 1, "character 55296 does not exist in XML"},
        {"a document type", "<!DOCTYPE a [<!ENTITY b 'c'>]>\n<a/>", 1,
         "a document type declaration is not accepted"},
        {"a declaration inside", "<a><!ELEMENT b></a>", 1, "a declaration is not accepted here"},
        {"another encoding", "<?xml version='1.0' encoding='latin1'?><a/>", 1, "encoding latin1: not UTF-8"},
        {"bytes that are not UTF-8", "<a>\n\xFF</a>", 2, "not UTF-8"},
        {"a bad name", "<1/>", 1, "expected a name"},
        {"deep nesting", String.duplicate("<a>", 17), 1, "elements nested deeper than 16"}
      ] do
    test "refuses #{what}" do
      assert XML.parse(unquote(xml)) == {:error, unquote(line), unquote(reason)}
    end
  end

  test "refuses what is too large" do
    assert {:error, nil, "larger than" <> _} = XML.parse(String.duplicate(" ", 4 * 1024 * 1024 + 1))
  end

  test "any bytes: a result, never an exception" do
    pieces = [
      "<",
      ">",
      "/",
      "a",
      "=",
      "'",
      "\"",
      "&",
      ";",
      "#",
      "!--",
      "-->",
      "<![CDATA[",
      "]]>",
      "?",
      " ",
      "\n",
      <<255>>
    ]

    property =
      :proper.forall(:proper_types.list(:proper_types.oneof(pieces)), fn list ->
        case list |> IO.iodata_to_binary() |> XML.parse() do
          {:ok, {:element, _, _, _, _}} -> true
          {:error, _line, reason} -> is_binary(reason)
        end
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
  end
end
