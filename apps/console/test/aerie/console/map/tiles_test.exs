defmodule Aerie.Console.Map.TilesTest do
  use Aerie.ConsoleCase, async: true

  import Aerie.MapPage, only: [browse_map: 2, browse_map: 3]
  import ExUnit.CaptureLog

  alias Aerie.Console.Map.Tiles

  @moduletag :tmp_dir
  # One white pixel.
  @png Base.decode64!(
         "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGP4DwABAQEAsTj2FAAAAABJRU5ErkJggg=="
       )

  defp varint(n) when n < 128, do: <<n>>
  defp varint(n), do: <<1::1, Bitwise.band(n, 127)::7, varint(div(n, 128))::binary>>

  defp directory(entries) do
    {ids, _last} = Enum.map_reduce(entries, 0, fn {id, _, _, _}, last -> {id - last, id} end)
    columns = [ids | for(n <- [1, 3, 2], do: Enum.map(entries, &elem(&1, n)))]
    IO.iodata_to_binary([varint(length(entries)) | for(column <- columns, n <- column, do: varint(n))])
  end

  # One tile, of the whole world; `type` 1 is vectors, 2 PNG.
  defp pmtiles(type, tile, metadata \\ "{}") do
    root = :zlib.gzip(directory([{0, 1, 1, byte_size(tile)}]))
    metadata = :zlib.gzip(metadata)
    data = 127 + byte_size(root) + byte_size(metadata)

    header =
      <<"PMTiles", 3, 127::little-64, byte_size(root)::little-64, 127 + byte_size(root)::little-64,
        byte_size(metadata)::little-64, data::little-64, 0::64, data::little-64, byte_size(tile)::little-64,
        0::192, 1, 2, 1, type, 0, 0, -180 * 10_000_000::little-32, -85 * 10_000_000::little-32,
        180 * 10_000_000::little-32, 85 * 10_000_000::little-32, 0, 0::64>>

    header <> root <> metadata <> tile
  end

  # A vector tile with the layer `water`, whose one polygon is all of it (Mapbox's specification, version 2.1).
  defp water do
    zigzag = fn n -> Bitwise.bxor(Bitwise.bsl(n, 1), Bitwise.bsr(n, 63)) end
    moves = [9, 0, 0, 26, zigzag.(4096), 0, 0, zigzag.(4096), zigzag.(-4096), 0, 15]
    geometry = for n <- moves, into: "", do: varint(n)
    feature = <<24, 3, 34, byte_size(geometry)>> <> geometry
    layer = <<10, 5, "water", 18, byte_size(feature)>> <> feature <> <<40>> <> varint(4096) <> <<120, 2>>
    <<26, byte_size(layer)>> <> layer
  end

  defp file(dir, bytes, name \\ "map") do
    path = Path.join(dir, name <> ".pmtiles")
    File.write!(path, bytes)
    path
  end

  defp get(console, path, headers) do
    {:ok, {{_, status, _}, headers, body}} =
      :httpc.request(:get, {~c"#{console.url}#{path}", headers}, [], body_format: :binary)

    {status, Map.new(headers, fn {name, value} -> {to_string(name), to_string(value)} end), body}
  end

  defp signed_in(console) do
    session =
      Aerie.Access.Session.of_user(
        console.gateway,
        Aerie.Access.Users.find(console.gateway, "viewer")
      )

    %{secret: secret, cookie: name} = console.server
    [{~c"cookie", ~c"#{name}=#{Phoenix.LiveView.Token.sign(secret, "cookie", session)}"}]
  end

  defp start(dir, tiles) do
    config = %{console: %{dir: Path.join(dir, "c"), tiles: tiles, tiles_attribution: "(c) me"}}
    [console: console] = start_console(config: config, dir: Path.join(dir, "c"))
    console
  end

  test "ranges of a PMTiles file go to signed-in users, and the map knows its address", %{tmp_dir: dir} do
    whole = pmtiles(2, "tile!")
    path = file(dir, whole)
    console = start(dir, path)
    assert Tiles.description(console.gateway) == %{archive: "/tiles/archive", attribution: "(c) me"}

    {:ok, view, _html} = live(conn(console, :viewer), "/")
    assert view |> element("#fleet-map") |> render() =~ "/tiles/archive"

    assert {401, _headers, _body} = get(console, "/tiles/archive", range("0-9"))
    cookie = signed_in(console)
    get = fn range -> get(console, "/tiles/archive", range(range) ++ cookie) end

    assert {206, %{"content-range" => range, "etag" => etag}, <<"PMTiles", 3, _::binary-2>>} = get.("0-9")
    assert range == "bytes 0-9/#{byte_size(whole)}"
    last = byte_size(whole) - 1
    assert {206, %{"etag" => ^etag}, "tile!"} = get.("#{last - 4}-#{last + 1_000}")

    # Several, from the end, without an end, beyond it, too long, and no range at all.
    for range <- ["0-1,3-4", "-5", "0-", "#{last + 1}-#{last + 9}", "9-0", "x", "0-99999999999"] do
      expected = if range == "0-99999999999", do: 206, else: 416
      assert {^expected, _headers, _body} = get.(range)
    end

    assert {416, _headers, "ask for one range" <> _} = get(console, "/tiles/archive", cookie)
    File.write!(path, whole <> String.duplicate("x", 20_000_000))
    assert {416, _headers, _body} = get.("0-17000000")
    File.rm!(path)
    assert {404, _headers, _body} = get.("0-9")
    assert {404, _headers, _body} = get(console, "/tiles/0/0/0", cookie)
  end

  describe "in a browser, a PMTiles file" do
    @describetag :chromium

    test "of vectors is drawn by the names of its layers", %{tmp_dir: dir} do
      metadata = JSON.encode!(%{vector_layers: [%{id: "water"}]})
      console = start(dir, file(dir, pmtiles(1, water(), metadata)))
      assert browse_map(console, "tiles", ["vector"]) =~ "ok"
    end

    test "of images is drawn", %{tmp_dir: dir} do
      console = start(dir, file(dir, pmtiles(2, @png)))
      assert browse_map(console, "tiles", ["raster"]) =~ "ok"
    end

    test "that is damaged is left out, and the map says so in the browser's log", %{tmp_dir: dir} do
      console = start(dir, file(dir, <<"PMTiles", 3>> <> String.duplicate("x", 300)))
      assert browse_map(console, "notiles") =~ "ok"
    end
  end

  defp range(text), do: [{~c"range", ~c"bytes=#{text}"}]

  test "tiles of a folder go to signed-in users", %{tmp_dir: dir} do
    File.mkdir_p!(Path.join(dir, "tiles/0/0"))
    File.write!(Path.join(dir, "tiles/0/0/0.png"), "world")
    console = start(dir, Path.join(dir, "tiles"))

    assert %{type: "raster", url: "/tiles/{z}/{x}/{y}", maxzoom: 0, attribution: "(c) me"} =
             Tiles.description(console.gateway)

    assert {401, _headers, _body} = get(console, "/tiles/0/0/0", [])
    cookie = signed_in(console)
    assert {200, %{"content-type" => "image/png"}, "world"} = get(console, "/tiles/0/0/0", cookie)

    for path <- ["/tiles/archive", "/tiles/1/0/0", "/tiles/-1/0/0", "/tiles/0/0/x", "/tiles/0/0/99999999999"],
        do: assert({404, _, _} = get(console, path, cookie))
  end

  test "a folder of images", %{tmp_dir: dir} do
    File.mkdir_p!(Path.join(dir, "tiles/3/4"))
    File.write!(Path.join(dir, "tiles/3/4/2.png"), "image")
    gateway = make_ref()
    start_supervised!({Tiles, gateway: gateway, path: Path.join(dir, "tiles"), attribution: nil})
    assert %{type: "raster", minzoom: 3, maxzoom: 3} = Tiles.description(gateway)
    assert Tiles.tile(gateway, 3, 4, 2) == {"image", "image/png", false}
    assert Tiles.tile(gateway, 3, 4, 3) == nil
  end

  test "what holds no tiles is said, and the map goes on without", %{tmp_dir: dir} do
    for {path, reason} <- [
          {dir, "expected a PMTiles file, or a folder"},
          {file(dir, "PMTile", "short"), "it is not a PMTiles file"},
          {file(dir, <<"PMTiles", 2>>, "old"), "it is PMTiles version 2; only version 3 is supported"},
          {Path.join(dir, "nowhere"), "no such file"}
        ] do
      gateway = make_ref()

      log =
        capture_log(fn ->
          start_supervised!({Tiles, gateway: gateway, path: path, attribution: nil}, id: gateway)
        end)

      assert log =~ reason
      assert Tiles.description(gateway) == nil
      assert Tiles.archive(gateway) == nil
    end
  end
end
