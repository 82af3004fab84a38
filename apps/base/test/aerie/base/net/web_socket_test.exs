defmodule Aerie.Base.Net.WebSocketTest do
  @moduledoc "The side of a server: requests and masked frames, however they are cut (RFC 6455)."
  use ExUnit.Case, async: true

  alias Aerie.Base.Net.WebSocket.{Frames, Handshake}

  @key "dGhlIHNhbXBsZSBub25jZQ=="
  @request "GET /chat HTTP/1.1\r\nHost: server.example\r\nUpgrade: WebSocket\r\nConnection: Upgrade\r\n" <>
             "Sec-WebSocket-Key: #{@key}\r\nOrigin: https://page.example\r\n" <>
             "Sec-WebSocket-Protocol: chat, superchat\r\nSec-WebSocket-Version: 13\r\n\r\n"

  test "the standard's own example" do
    assert {:ok, request, "rest"} = Handshake.accept(@request <> "rest")
    assert request == %{key: @key, origin: "https://page.example", protocol: "chat"}
    answer = IO.iodata_to_binary(Handshake.accepted(request))
    assert answer =~ "HTTP/1.1 101 " and answer =~ "Sec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\n"
    assert answer =~ "Sec-WebSocket-Protocol: chat\r\n"

    for at <- 0..(byte_size(@request) - 1),
        do: assert(Handshake.accept(binary_part(@request, 0, at)) == :more)
  end

  test "what is not such a request has an answer that says so, and no end" do
    for text <- [
          "GET / HTTP/1.1\r\nHost: x\r\n\r\n",
          "POST /chat HTTP/1.1\r\nUpgrade: websocket\r\nSec-WebSocket-Key: #{@key}\r\n\r\n",
          "GET / HTTP/1.1\r\nUpgrade: websocket\r\nSec-WebSocket-Key: short\r\n\r\n",
          "$M<\r\n\r\n",
          "G" <> String.duplicate("x", 20_000)
        ] do
      assert {:error, answer} = Handshake.accept(text)
      assert IO.iodata_to_binary(answer) =~ "HTTP/1.1 400"
    end

    assert {:ok, %{protocol: nil}, ""} =
             @request |> String.replace("chat, superchat", "ch at\t") |> Handshake.accept()
  end

  test "masked frames in any pieces are the bytes that were sent; controls between them" do
    property =
      :proper.forall(
        {:proper_types.list(:proper_types.binary()), :proper_types.list(:proper_types.range(1, 40))},
        fn {messages, cuts} ->
          stream =
            IO.iodata_to_binary(
              for message <- messages,
                  do: [:cow_ws.masked_frame({:binary, message}, %{}), :cow_ws.masked_frame({:ping, "p"}, %{})]
            )

          {events, _frames} = push(Frames.new(:client), stream, cuts)
          data = for {:data, bytes} <- events, into: <<>>, do: bytes

          data == IO.iodata_to_binary(messages) and
            Enum.count(events, &(&1 == {:ping, "p"})) == length(messages)
        end
      )

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
    assert {[:bad], _} = Frames.push(Frames.new(:client), IO.iodata_to_binary(Frames.reply("x")))
    assert {[{:data, "x"}], _} = Frames.push(Frames.new(), IO.iodata_to_binary(Frames.reply("x")))

    assert {[{:close, 1001, "bye"}], _} =
             Frames.push(Frames.new(:client), IO.iodata_to_binary(Frames.control({:close, 1001, "bye"})))
  end

  defp push(frames, "", _cuts), do: {[], frames}

  defp push(frames, bytes, cuts) do
    {size, cuts} = List.pop_at(cuts, 0, byte_size(bytes))
    size = min(size, byte_size(bytes))
    <<piece::binary-size(^size), rest::binary>> = bytes
    {events, frames} = Frames.push(frames, piece)
    {more, frames} = push(frames, rest, cuts)
    {events ++ more, frames}
  end
end
