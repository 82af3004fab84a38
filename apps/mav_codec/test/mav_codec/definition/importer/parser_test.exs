defmodule MavCodec.Definition.Importer.ParserTest do
  @moduledoc "One file: one feature, or one mistake, each."
  use ExUnit.Case, async: true

  alias MavCodec.Definition.{Error, Facts}
  alias MavCodec.Definition.Importer.Parser

  # Each XML and the facts it gives, without the head.
  @features %{
    "version, dialect, includes" => {
      "<include> minimal.xml\n</include><include>../other/b.xml</include><version>3</version><dialect>7</dialect>",
      """
      version 3
      dialect 7
      include minimal.xml
      include ../other/b.xml
      """
    },
    "a message, fields in the order of the XML" => {
      "<messages><message id='300' name='TINY'><description>Prose.</description>" <>
        "<field type='uint8_t' name='a'>Prose.</field><field type='double' name='b'/></message></messages>",
      """

      message 300 TINY
        uint8_t a
        double b
      """
    },
    "extensions" => {
      "<messages><message id='1' name='M'><field type='uint8_t' name='a'/><extensions/>" <>
        "<field type='uint32_t' name='b'/></message></messages>",
      """

      message 1 M
        uint8_t a
        extensions
        uint32_t b
      """
    },
    "arrays, text, and the old ways to write types" => {
      "<messages><message id='1' name='M'><field type='char[16]' name='a'/><field type='uint8_t[3]' name='b'/>" <>
        "<field type='float[4]' name='c'/><field type='array[2]' name='d'/><field type='uint16' name='e'/>" <>
        "<field type='char' name='f'/></message></messages>",
      """

      message 1 M
        char[16] a
        uint8_t[3] b
        float[4] c
        int8_t[2] d
        uint16_t e
        char f
      """
    },
    "uint8_t_mavlink_version has the value of the file's version" => {
      "<messages><message id='1' name='M'><field type='uint8_t_mavlink_version' name='v'/></message></messages>" <>
        "<version>2</version>",
      """
      version 2

      message 1 M
        uint8_t v constant=2
      """
    },
    "the facts of a field" => {
      ~S(<messages><message id='1' name='M'><field type='int16_t' name='a' units='[cm]' enum='E' display='bitmask' ) <>
        ~S(invalid='INT16_MAX' instance='true' multiplier='1E-2' minValue='0' maxValue='9' increment='0.1' default='a b' ) <>
        ~S(print_format='0x%04x' unknown='x'/></message></messages>),
      """

      message 1 M
        int16_t a enum=E units=cm invalid=INT16_MAX multiplier=1E-2 min=0 max=9 increment=0.1 default=a\\sb format=0x%04x instance bitmask
      """
    },
    "bytes in a char[]: said so, or known" => {
      ~S(<messages><message id='1' name='M'><field type='char[4]' name='a' display='bytes'/><field type='char[4]' name='b'/>) <>
        ~S(<field type='char' name='c' display='bytes'/></message>) <>
        ~S(<message id='323' name='PARAM_EXT_SET'><field type='char[16]' name='param_id'/>) <>
        ~S(<field type='char[128]' name='param_value'/></message></messages>),
      """

      message 1 M
        char[4] a bytes
        char[4] b
        char c

      message 323 PARAM_EXT_SET
        char[16] param_id
        char[128] param_value bytes
      """
    },
    "an enum; values decimal, hexadecimal, binary, as powers and as shifts; an entry without one gets the next" =>
      {
        "<enums><enum name='E'><description>Prose</description><entry value='3' name='E_A'><description>P</description>" <>
          "</entry><entry value='0x10' name='E_B'/><entry name='E_C'/><entry value='2**5' name='E_D'/>" <>
          "<entry value='1&lt;&lt;6' name='E_E'/><entry value='0b1000' name='E_F'/></enum></enums>",
        """

        enum E
          E_A 3
          E_B 16
          E_C 17
          E_D 32
          E_E 64
          E_F 8
        """
      },
    "a bitmask" => {
      "<enums><enum name='F' bitmask='true'><entry value='1' name='F_A'/></enum></enums>",
      """

      enum F bitmask
        F_A 1
      """
    },
    "an enum in two pieces is one" => {
      "<enums><enum name='E'><entry value='1' name='E_A'/></enum><enum name='E'><entry value='2' name='E_B'/></enum></enums>",
      """

      enum E
        E_A 1
        E_B 2
      """
    },
    "parameters of a command" => {
      "<enums><enum name='MAV_CMD'><entry value='16' name='MAV_CMD_X' hasLocation='true' isDestination='false'>" <>
        "<param index='1' label='Hold Time' units='s' minValue='0' maxValue=''>Prose.</param>" <>
        "<param index='2' reserved='true' default='NaN'/></entry></enum></enums>",
      """

      enum MAV_CMD
        MAV_CMD_X 16 hasLocation=true isDestination=false
          param 1 label=Hold\\sTime units=s minValue=0
          param 2 default=NaN reserved=true
      """
    },
    "deprecated, superseded and unfinished things" => {
      "<enums><enum name='E'><deprecated since='2018-01' replaced_by='a b'>Prose</deprecated>" <>
        "<entry value='1' name='E_A'><wip/></entry></enum></enums><messages><message id='1' name='M'>" <>
        "<superseded since='2020-02' replaced_by=''/><wip since='2020'/><field type='char' name='a'/></message></messages>",
      """

      enum E deprecated=2018-01 replaced_by=a\\sb
        E_A 1 wip

      message 1 M deprecated=2020-02 replaced_by= wip
        char a
      """
    },
    "comments, CDATA and entities in prose leave nothing behind" => {
      "<!-- <messages> --><messages><message id='1' name='M'><description>a &lt; b<![CDATA[<field>]]></description>" <>
        "<field type='char' name='a'/></message></messages>",
      """

      message 1 M
        char a
      """
    }
  }

  for {feature, {xml, facts}} <- @features do
    test feature do
      xml = "<mavlink>#{unquote(xml)}</mavlink>"
      assert {:ok, facts} = Parser.facts(xml, "tiny.xml")
      text = facts |> Facts.text() |> IO.iodata_to_binary()
      assert String.split(text, "\n", parts: 3) |> Enum.at(2) == unquote(facts)
      read = text |> Facts.facts() |> Facts.document("tiny.facts")
      assert without_lines(read) == xml |> Parser.parse("tiny.xml") |> without_lines()
    end
  end

  defp without_lines({:ok, document}) do
    %{
      document
      | includes: Enum.map(document.includes, &elem(&1, 0)),
        enums:
          for enum <- document.enums do
            %{enum | line: nil, entries: Enum.map(enum.entries, &%{&1 | line: nil})}
          end,
        messages:
          for message <- document.messages do
            %{message | line: nil, fields: Enum.map(message.fields, &%{&1 | line: nil})}
          end
    }
  end

  message = fn fields -> "<messages>\n<message id='1' name='M'>\n#{fields}\n</message></messages>" end
  field = fn attributes -> message.("<field #{attributes}/>") end
  enum = fn entries -> "<enums>\n<enum name='E'>\n#{entries}</enum></enums>" end

  @mistakes [
    {"XML that is none", "<a>", 1, "expected </a>"},
    {"an unknown element", "\n<massages/>", 2,
     "<massages> inside of mavlink, expected one of include, version, dialect, enums, messages"},
    {"a misspelt field", message.("<feild type='char' name='a'/>"), 3,
     "<feild> inside of message M, expected one of description, deprecated, superseded, wip, field, extensions"},
    {"stray text", message.("oops"), 2, ~S(text inside of message M: "\noops\n")},
    {"an empty include", "<include> </include>", 1, "empty <include>"},
    {"a version that is not a number", "<version>three</version>", 1,
     ~S(version is "three", expected an integer from 0 to 255)},
    {"a message without id", "<messages><message name='M'/></messages>", 1, "message M has no attribute id"},
    {"a message without name", "<messages><message id='1'/></messages>", 1, "message has no attribute name"},
    {"a message with a bad name", "<messages><message id='1' name='A B'/></messages>", 1,
     ~S(message name "A B": expected letters, digits and _, at most 64)},
    {"an id over 24 bits", "<messages><message id='16777216' name='M'/></messages>", 1,
     ~S(id of M is "16777216", expected an integer from 0 to 16777215)},
    {"a message without fields", message.(""), 2, "M has no fields"},
    {"a field without type", field.("name='a'"), 3, "field a has no attribute type"},
    {"a field without name", field.("type='char'"), 3, "field has no attribute name"},
    {"an unknown type", field.("name='a' type='uint24_t'"), 3, ~S(field a has the unknown type "uint24_t")},
    {"a broken array", field.("name='a' type='char[x]'"), 3, ~S(field a has the unknown type "char[x]")},
    {"an empty array", field.("name='a' type='char[0]'"), 3, "field a is an array of 0, expected 1 to 255"},
    {"a too long array", field.("name='a' type='char[256]'"), 3,
     "field a is an array of 256, expected 1 to 255"},
    {"a bad instance", field.("name='a' type='char' instance='yes'"), 3,
     ~S(instance="yes", expected true or false)},
    {"F11: a payload over 255 bytes", field.("name='a' type='double[32]'"), 2,
     "M has a payload of 256 bytes, more than 255"},
    {"F11: over 64 fields", message.(for i <- 1..65, into: "", do: "<field type='char' name='f#{i}'/>"), 2,
     "M has 65 fields, more than 64"},
    {"a field twice", message.("<field type='char' name='a'/>\n<field type='float' name='a'/>"), 4,
     "field a of M is defined twice (first in line 3)"},
    {"fields that differ in case", message.("<field type='char' name='a'/>\n<field type='float' name='A'/>"),
     4, "field a of M is defined twice (first in line 3)"},
    {"a message id twice",
     "<messages><message id='1' name='M'><field type='char' name='a'/></message>\n" <>
       "<message id='1' name='N'><field type='char' name='a'/></message></messages>", 2,
     "message id 1 is defined twice (first in line 1)"},
    {"a message name twice",
     "<messages><message id='1' name='M'><field type='char' name='a'/></message>\n" <>
       "<message id='2' name='M'><field type='char' name='a'/></message></messages>", 2,
     "message name M is defined twice (first in line 1)"},
    {"an entry without name", enum.("<entry value='1'/>"), 3, "entry has no attribute name"},
    {"an entry with a bad value", enum.("<entry name='E_A' value='one'/>"), 3,
     ~S(value of E_A is "one", expected an integer from 0 to 18446744073709551615)},
    {"an entry twice", enum.("<entry name='E_A' value='1'/>\n<entry name='E_A' value='2'/>"), 4,
     "entry E_A of enum E is defined twice (first in line 3)"},
    {"a value twice", enum.("<entry name='E_A' value='1'/>\n<entry name='E_B' value='1'/>"), 4,
     "value 1 of enum E is defined twice (first in line 3)"},
    {"a bad bitmask", "<enums><enum name='E' bitmask='maybe'/></enums>", 1,
     ~S(bitmask="maybe", expected true or false)},
    {"a parameter 8", enum.("<entry name='E_A' value='1'><param index='8'/></entry>"), 3,
     ~S(index is "8", expected an integer from 0 to 7)}
  ]

  for {mistake, xml, line, reason} <- @mistakes do
    test "refuses #{mistake}" do
      assert Parser.parse("<mavlink>#{unquote(xml)}</mavlink>", "bad.xml") ==
               {:error, %Error{file: "bad.xml", line: unquote(line), reason: unquote(reason)}}
    end
  end

  test "refuses another root element" do
    assert {:error, error} = Parser.parse("<html/>", "page.xml")
    assert Exception.message(error) == "page.xml:1: the root element is <html>, expected <mavlink>"
  end

  test "facts that are damaged are an error with their line" do
    for {text, line, reason} <- [
          {"nonsense", 1, "not a line of facts"},
          {"message x M\n", 1, "id of M is \"x\", expected an integer from 0 to 16777215"},
          {"message 1 M\n  uint24_t a\n", 2, "field a has the unknown type \"uint24_t\""},
          {"message 1 M\n  char a\n    char b\n", 3, "not a line of facts"},
          {"enum E\n  A\n", 2, "not a line of facts"},
          {"enum E\n  A 1\n    what 1\n", 3, "not a line of facts"},
          {"  A 1\n", 1, "not a line of facts"},
          {"message 1 M oops\n  char a\n", 1, "not a line of facts"}
        ] do
      assert text |> Facts.facts() |> Facts.document("x.facts") ==
               {:error, %Error{file: "x.facts", line: line, reason: reason}}
    end
  end
end
