defmodule Gnat.ParsecTest do
  use ExUnit.Case, async: true

  alias Gnat.{Headers, Parsec}

  @runs 300

  defp parse(bytes, opts \\ []), do: Parsec.parse(Parsec.new(opts), bytes)

  describe "whole messages" do
    test "of each kind" do
      for {bytes, message} <- [
            {"PING\r\n", :ping},
            {"PONG\r\n", :pong},
            {"+OK\r\n", :ok},
            {"-ERR 'Stale Connection'\r\n", {:error, "Stale Connection"}},
            {"-ERR\r\n", {:error, ""}},
            {"MSG a.b 7 2\r\nhi\r\n", {:msg, "a.b", 7, nil, "hi"}},
            {"MSG a.b 7 back 0\r\n\r\n", {:msg, "a.b", 7, "back", ""}},
            {"MSG  a.b\t7   2\r\nhi\r\n", {:msg, "a.b", 7, nil, "hi"}},
            {"HMSG a 7 12 14\r\nNATS/1.0\r\n\r\nhi\r\n",
             {:hmsg, "a", 7, nil, %{status: nil, description: nil, headers: []}, "hi"}},
            {"HMSG a 7 back 16 16\r\nNATS/1.0 503\r\n\r\n\r\n",
             {:hmsg, "a", 7, "back", %{status: "503", description: nil, headers: []}, ""}},
            {"INFO {\"version\":\"2.15.1\",\"max_payload\":1048576,\"unheard_of\":1}\r\n",
             {:info, %{version: "2.15.1", max_payload: 1_048_576}}}
          ] do
        assert {:ok, parser, [^message]} = parse(bytes)
        assert Parsec.empty?(parser)
      end
    end

    test "several in one read, the last cut off" do
      assert {:ok, parser, [:ping, {:msg, "a", 1, nil, "x"}, :pong]} =
               parse("PING\r\nMSG a 1 1\r\nx\r\nPONG\r\nMSG b 2 3\r\nab")

      refute Parsec.empty?(parser)
      assert {:ok, parser, []} = Parsec.parse(parser, "c\r")
      assert {:ok, _parser, [{:msg, "b", 2, nil, "abc"}, :ping]} = Parsec.parse(parser, "\nPING\r\n")
    end
  end

  describe "invalid input is an error" do
    test "with the messages that came before it" do
      assert {:error, "unknown command \"HELLO\"", [:ping]} = parse("PING\r\nHELLO\r\nPONG\r\n")
    end

    test "in each of its forms" do
      for {bytes, why} <- [
            {"\r\n", "unknown command"},
            {"MSG\r\n", "unknown command"},
            {"MSG a\r\n", "bad MSG line"},
            {"MSG a 1 r r 1\r\n", "bad MSG line"},
            {"MSG a x 1\r\n", "bad MSG line"},
            {"MSG a 1 -1\r\n", "bad MSG line"},
            {"MSG a 1 1e3\r\n", "bad MSG line"},
            {"MSG a 1 99999999999999999999\r\n", "bad MSG line"},
            {"MSG a 1 999999999999\r\n", "bad MSG line"},
            {"MSG a 1 2\r\nhixx", "does not end where it should"},
            {"HMSG a 1 5 4\r\n", "bad HMSG line"},
            {"HMSG a 1 4\r\n", "bad HMSG line"},
            {"HMSG a 1 2 3\r\nabcde", "does not end where it should"},
            {"INFO nonsense\r\n", "not a JSON object"},
            {"INFO []\r\n", "not a JSON object"},
            {"INFO {\"max_payload\":\"x\"}\r\n", "bad max_payload"},
            {"INFO {\"tls_required\":1}\r\n", "bad tls_required"},
            {String.duplicate("x", 65_537), "control line"},
            {String.duplicate("x", 70_000) <> "\r\n", "control line"}
          ] do
        assert {:error, text, []} = parse(bytes)
        assert text =~ why
      end
    end

    test "an unknown field of INFO becomes no atom" do
      name = "never_heard_#{System.unique_integer([:positive])}"
      assert {:ok, _, [{:info, info}]} = parse("INFO {\"#{name}\":1}\r\n")
      assert info == %{}
      assert_raise ArgumentError, fn -> String.to_existing_atom(name) end
    end

    test "a body above the limit is refused before it comes" do
      assert {:error, _, []} = parse("MSG a 1 11\r\n", max_body: 10)
      assert {:ok, _, []} = parse("MSG a 1 10\r\n", max_body: 10)
    end
  end

  test "a line in single bytes is searched once, not once for each byte" do
    # 60 000 bytes one at a time: with a search from the start each time these would be 1.8 thousand million steps.
    line = "MSG " <> String.duplicate("x", 60_000) <> " 1 0\r\n\r\n"

    {messages, _parser} =
      for <<byte <- line>>, reduce: {[], Parsec.new()} do
        {messages, parser} ->
          {:ok, parser, new} = Parsec.parse(parser, <<byte>>)
          {messages ++ new, parser}
      end

    assert [{:msg, _, 1, nil, ""}] = messages
  end

  describe "headers" do
    test "status and description" do
      assert %{status: "409", description: "Consumer Deleted", headers: []} =
               Headers.decode("NATS/1.0 409 Consumer Deleted\r\n\r\n")
    end

    test "invalid lines are left out, bytes that are not UTF-8 are kept" do
      assert %{headers: [{"a", <<255>>}, {"b", ""}]} =
               Headers.decode("NATS/1.0\r\nx\r\n: y\r\nA: \xFF \r\nB:\r\n\r\n")
    end
  end

  describe "properties" do
    test "any split of the bytes gives the same messages" do
      property =
        :proper.forall(
          {:proper_types.non_empty(:proper_types.list(message())),
           :proper_types.list(:proper_types.range(1, 40))},
          fn {parts, cuts} ->
            bytes = parts |> Enum.map(&elem(&1, 0)) |> IO.iodata_to_binary()
            expected = Enum.map(parts, &elem(&1, 1))
            feed(split(bytes, cuts)) == {:ok, expected}
          end
        )

      check(property)
    end

    test "garbage is an error or nothing yet, in any split, and never an exception" do
      property =
        :proper.forall(
          {:proper_types.binary(), garbled(), :proper_types.list(:proper_types.range(1, 10))},
          fn {noise, garbled, cuts} ->
            Enum.all?([noise, garbled, noise <> "\r\n"], fn bytes ->
              whole = feed([bytes])
              elem(whole, 0) in [:ok, :error] and feed(split(bytes, cuts)) == whole
            end)
          end
        )

      check(property)
    end

    test "headers come back as they were sent, and no header block raises" do
      property =
        :proper.forall(
          {:proper_types.list(
             {:proper_types.non_empty(:proper_types.list(:proper_types.range(?a, ?z))), text()}
           ), :proper_types.binary()},
          fn {pairs, noise} ->
            headers = for {name, value} <- pairs, do: {List.to_string(name), value}
            {:ok, block} = Headers.encode(headers)
            trimmed = for {name, value} <- headers, do: {name, value |> trim() |> flip() |> trim() |> flip()}
            %{headers: _} = Headers.decode(noise)
            Headers.decode(IO.iodata_to_binary(block)).headers == trimmed
          end
        )

      check(property)
    end
  end

  defp check(property) do
    # The counterexample, and not the property, is what is worth reading.
    case :proper.counterexample(property, [:quiet, numtests: @runs]) do
      true -> :ok
      counterexample -> flunk("does not hold for #{inspect(counterexample, limit: :infinity)}")
    end
  end

  # The parser over several reads: all messages, or those before the error and the error.
  defp feed(reads), do: feed(reads, Parsec.new(max_body: 100_000), [])

  defp feed([], _parser, messages), do: {:ok, messages}

  defp feed([bytes | rest], parser, messages) do
    case Parsec.parse(parser, bytes) do
      {:ok, parser, new} -> feed(rest, parser, messages ++ new)
      {:error, why, new} -> {:error, messages ++ new, why}
    end
  end

  defp split("", _cuts), do: []
  defp split(bytes, []), do: [bytes]

  defp split(bytes, [cut | cuts]) do
    cut = min(cut, byte_size(bytes))
    [binary_part(bytes, 0, cut) | split(binary_part(bytes, cut, byte_size(bytes) - cut), cuts)]
  end

  # {bytes on the wire, the message they are}
  defp message do
    :proper_types.oneof([
      {"PING\r\n", :ping},
      {"PONG\r\n", :pong},
      {"-ERR 'no'\r\n", {:error, "no"}},
      map({:proper_types.binary(), :proper_types.oneof([nil, "back.to"])}, fn {body, reply} ->
        {["MSG a.b 3 ", if(reply, do: [reply, " "], else: []), "#{byte_size(body)}\r\n", body, "\r\n"],
         {:msg, "a.b", 3, reply, body}}
      end),
      map({:proper_types.binary(), :proper_types.list(text())}, fn {body, values} ->
        headers = for value <- values, do: {"x", value}
        {:ok, block} = Headers.encode(headers)
        size = IO.iodata_length(block)

        {["HMSG a.b 3 #{size} #{size + byte_size(body)}\r\n", block, body, "\r\n"],
         {:hmsg, "a.b", 3, nil, Headers.decode(IO.iodata_to_binary(block)), body}}
      end)
    ])
  end

  # Messages with one byte changed.
  defp garbled do
    map({message(), :proper_types.integer(0, 200), :proper_types.byte()}, fn {{bytes, _}, at, byte} ->
      bytes = IO.iodata_to_binary(bytes)
      at = rem(at, byte_size(bytes))
      <<before::binary-size(^at), _, rest::binary>> = bytes
      before <> <<byte>> <> rest
    end)
  end

  defp text do
    map(:proper_types.binary(), fn bytes ->
      for <<byte <- bytes>>, byte not in [?\r, ?\n], into: "", do: <<byte>>
    end)
  end

  defp map(type, fun), do: :proper_types.bind(type, fun, false)

  defp trim(<<blank, rest::binary>>) when blank in [?\s, ?\t], do: trim(rest)
  defp trim(value), do: value
  defp flip(value), do: value |> :binary.bin_to_list() |> Enum.reverse() |> :binary.list_to_bin()
end
