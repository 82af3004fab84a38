defmodule Aerie.Console.Map.Tiles.AnswerTest do
  use ExUnit.Case, async: true

  alias Aerie.Console.Map.Tiles.Fetcher.Answer
  alias Aerie.TileServer

  @now 1_000_000
  @day 86_400

  defp read(status, headers, body, kind \\ :raster, held \\ nil),
    do: Answer.read({:ok, status, headers, body}, kind, held, @now)

  test "a tile is kept for a week at least, and two months at most" do
    for {said, days} <- [
          {nil, 7},
          {"no-store", 7},
          {"max-age=60", 7},
          {"public, max-age=864000", 10},
          {"max-age=999999999", 60}
        ] do
      headers = if said, do: %{"cache-control" => said, "etag" => ~s("a")}, else: %{}
      assert {:ok, %{until: until, type: "image/png", etag: etag}} = read(200, headers, TileServer.png())
      assert until == @now + days * @day
      assert etag == if(said, do: ~s("a"))
    end
  end

  test "what the server still has the same is kept longer; what it has not is not asked for each time" do
    held = %{type: "image/png", gzip?: false, etag: "e", until: 0, body: "x"}
    assert {:ok, %{body: "x", etag: "e", until: until}} = read(304, %{}, "", :raster, held)
    assert until == @now + 7 * @day
    assert {:error, "it answered 304", nil} = read(304, %{}, "")
    for status <- [204, 404, 410], do: assert({:ok, %{body: "", until: 1_086_400}} = read(status, %{}, ""))
  end

  test "anything else than a tile of the layer's kind is refused, whatever it is called" do
    html = {"<html>Accept the terms of this hotspot</html>", %{"content-type" => "image/png; x\r\n"}}
    {body, headers} = html

    for kind <- [:raster, :vector] do
      assert {:error, text, nil} = read(200, headers, body, kind)
      assert text =~ "other than a tile of #{kind} (image/png)"
    end

    assert {:error, _words, nil} = read(200, %{}, "", :raster)
    assert {:error, _words, nil} = read(200, %{}, TileServer.png(), :vector)
    assert {:ok, %{type: "image/jpeg"}} = read(200, %{}, <<0xFF, 0xD8, 0xFF, 0>>)
    assert {:ok, %{gzip?: true}} = read(200, %{}, :zlib.gzip(<<0x1A>>), :vector)
    assert {:ok, %{gzip?: false, type: "application/x-protobuf"}} = read(200, %{}, <<0x1A, 0>>, :vector)
  end

  test "errors say how long to leave the server alone" do
    assert {:error, "it answered 503", 120} = read(503, %{"retry-after" => "120"}, "")
    assert {:error, "it answered 429", 3_600} = read(429, %{"retry-after" => "99999999"}, "")
    assert {:error, "it answered 500", nil} = read(500, %{"retry-after" => "Wed, 21 Oct"}, "")
    assert {:error, "it refuses us (403): is the key right?", 60} = read(403, %{}, "")
  end
end
