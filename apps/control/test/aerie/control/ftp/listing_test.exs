defmodule Aerie.Control.Ftp.ListingTest do
  @moduledoc "What vehicles answer to ListDirectory: `test/fixtures/ftp` has the data of answers in hexadecimal digits."
  use ExUnit.Case, async: true

  import :proper_types

  alias Aerie.Control.Ftp.{Client, Listing, Name}
  alias MavCodec.Ftp.Packet
  alias MavCodec.Messages.FileTransferProtocol

  @fixtures Path.expand("../../../fixtures/ftp", __DIR__)

  defp fixture(name),
    do:
      @fixtures |> Path.join(name <> ".hex") |> File.read!() |> String.trim() |> Base.decode16!(case: :lower)

  defp entries(data) do
    {:more, listing} = Listing.took(%Listing{}, data)
    Listing.entries(listing)
  end

  defp names(data), do: Enum.map(entries(data), & &1.name)

  test "names that are not UTF-8 are text, and the others beside them are untouched" do
    assert names(fixture("list-latin1")) == ["caf\\xE9.txt", "ok.txt"]
    assert [%{kind: :file, size: 7, name: "\\xF0\\x9F\\x9A.bin"}] = entries(fixture("cut-utf8"))
  end

  test "fields after the name do not belong to it" do
    assert entries(fixture("dir-fields")) ==
             [%{kind: :directory, name: "logs", size: nil}, %{kind: :file, name: "a.bin", size: 100}]

    assert [%{name: "x", size: nil}, %{name: "y", size: nil}] = entries("Fx\tmany\0Fy\t-1\0")
  end

  test "the folder itself, the one above and what has no name are left out, but counted" do
    assert names(fixture("dots")) == ["logs"]
    assert {:more, %{offset: 4, entries: []}} = Listing.took(%Listing{}, "D.\t0\0D..\t0\t1\0D\0F\t5\0")
  end

  test "what a listing shows is what can be asked for, whatever bytes a name has" do
    property =
      :proper.forall(list(oneof([byte(), ?\\, ?x, ?E, ?9, ?5, ?C])), fn bytes ->
        name = :erlang.list_to_binary(bytes)
        text = Name.text(name)
        String.valid?(text) and Name.bytes(text) == name
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 2000]) == true, inspect(:proper.counterexample())
  end

  test "text hides no character of ASCII, and nothing else" do
    assert Name.bytes("/APM/scripts/a.l\\x75a \\x2F \\xe9 \\xE") == "/APM/scripts/a.l\\x75a \\x2F \\xe9 \\xE"
    assert Name.text("C:\\x5C") == "C:\\x5Cx5C"
    assert Name.text("a\\b") == "a\\b"
  end

  test "a file is read by the bytes of its name" do
    client = Client.new({:read, "/caf\\xE9.txt"}, {1, 1}, 600_000_000)
    {_client, [{:send, [%FileTransferProtocol{} = open]}]} = Client.handle(client, {:start, 0})
    <<_header::binary-size(12), data::binary>> = open.payload
    assert String.starts_with?(data, <<"/caf", 0xE9, ".txt", 0>>)
    assert Packet.opcode(:open) == :binary.at(open.payload, 3)
  end
end
