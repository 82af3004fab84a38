defmodule Aerie.Console.Map.TilesTest do
  use Aerie.ConsoleCase, async: true

  import ExUnit.CaptureLog

  alias Aerie.Console.Map.{PMTiles, Tiles}

  @moduletag :tmp_dir

  defp varint(n) when n < 128, do: <<n>>
  defp varint(n), do: <<1::1, Bitwise.band(n, 127)::7, varint(div(n, 128))::binary>>

  defp directory(entries) do
    {ids, _last} = Enum.map_reduce(entries, 0, fn {id, _, _, _}, last -> {id - last, id} end)
    columns = [ids | for(n <- [1, 3, 2], do: Enum.map(entries, &elem(&1, n)))]
    IO.iodata_to_binary([varint(length(entries)) | for(column <- columns, n <- column, do: varint(n))])
  end

  # The tile 0/0/0 in the root directory, 1/1/1 and those after it in a leaf; `type` 2 is PNG, 1 vector.
  defp pmtiles(type \\ 2, metadata \\ "{}") do
    data = "world" <> "tile!"
    leaf = :zlib.gzip(directory([{3, 2, 6, 5}]))
    root = :zlib.gzip(directory([{0, 1, 1, 5}, {1, 0, 1, byte_size(leaf)}]))
    metadata = :zlib.gzip(metadata)
    at = 127
    leaves = at + byte_size(root) + byte_size(metadata)

    header =
      <<"PMTiles", 3, at::little-64, byte_size(root)::little-64, at + byte_size(root)::little-64,
        byte_size(metadata)::little-64, leaves::little-64, byte_size(leaf)::little-64,
        leaves + byte_size(leaf)::little-64, byte_size(data)::little-64, 0::192, 1, 2, 1, type, 0, 1,
        80_000_000::little-32, 470_000_000::little-32, 90_000_000::little-32, 480_000_000::little-32, 0,
        0::64>>

    header <> root <> metadata <> leaf <> data
  end

  defp file(dir, bytes) do
    path = Path.join(dir, "map.pmtiles")
    File.write!(path, bytes)
    path
  end

  describe "a PMTiles file" do
    test "tiles are numbered along Hilbert's curve" do
      tiles = [{0, 0, 0}, {1, 0, 0}, {1, 0, 1}, {1, 1, 1}, {1, 1, 0}, {2, 0, 0}]
      assert for({z, x, y} <- tiles, do: PMTiles.id(z, x, y)) == Enum.to_list(0..5)
      # Each once.
      assert for(x <- 0..15, y <- 0..15, do: PMTiles.id(4, x, y)) |> Enum.sort() == Enum.to_list(85..340)
      assert PMTiles.id(12, 3423, 1763) == 19_078_479
    end

    test "tiles are found in the root and in leaves, runs of equal ones too", %{tmp_dir: dir} do
      {:ok, tiles} = PMTiles.open(file(dir, pmtiles()))

      assert %{type: :png, min_zoom: 0, max_zoom: 1, bounds: [8.0, 47.0, 9.0, 48.0], tile_gzip?: false} =
               tiles

      assert PMTiles.tile(tiles, 0, 0, 0) == {:ok, "world"}
      assert PMTiles.tile(tiles, 1, 1, 1) == {:ok, "tile!"}
      assert PMTiles.tile(tiles, 1, 1, 0) == {:ok, "tile!"}
      assert PMTiles.tile(tiles, 1, 0, 0) == {:ok, nil}
      assert PMTiles.tile(tiles, 2, 0, 0) == {:ok, nil}
      assert PMTiles.tile(tiles, 1, 2, 0) == {:ok, nil}
    end

    test "layers of vector tiles", %{tmp_dir: dir} do
      metadata = JSON.encode!(%{vector_layers: [%{id: "water"}, %{id: "roads"}]})
      assert {:ok, %{layers: ["water", "roads"]}} = PMTiles.open(file(dir, pmtiles(1, metadata)))
      assert {:error, "its metadata do not name" <> _} = PMTiles.open(file(dir, pmtiles(1)))
    end

    test "another file, or one broken anywhere, is an error and never a crash", %{tmp_dir: dir} do
      assert {:error, "it is not a PMTiles file"} = PMTiles.open(file(dir, String.duplicate("x", 200)))
      assert {:error, "it is shorter than it says"} = PMTiles.open(file(dir, "PMTiles"))
      assert {:error, "no such file" <> _} = PMTiles.open(Path.join(dir, "none"))
      whole = pmtiles()

      for at <- 8..(byte_size(whole) - 1) do
        <<before::binary-size(^at), byte, rest::binary>> = whole
        path = file(dir, <<before::binary, Bitwise.bxor(byte, 255), rest::binary>>)

        with {:ok, tiles} <- PMTiles.open(path) do
          assert {outcome, _tile_or_reason} = PMTiles.tile(tiles, 1, 1, 1)
          assert outcome in [:ok, :error]
        end
      end
    end
  end

  defp get(console, path, cookie) do
    {:ok, {{_, status, _}, headers, body}} =
      :httpc.request(:get, {~c"#{console.url}#{path}", cookie}, [], body_format: :binary)

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

  test "the gateway serves them to signed-in users, and tells the map", %{tmp_dir: dir} do
    path = file(dir, pmtiles())

    [console: console] =
      start_console(
        config: %{console: %{dir: Path.join(dir, "c"), tiles: path, tiles_attribution: "(c) me"}},
        dir: Path.join(dir, "c")
      )

    assert %{type: "raster", url: "/tiles/{z}/{x}/{y}", maxzoom: 1, attribution: "(c) me"} =
             Tiles.description(console.gateway)

    {:ok, view, _html} = live(conn(console, :viewer), "/")
    assert view |> element("#fleet-map") |> render() =~ "/tiles/{z}/{x}/{y}"

    assert {401, _headers, _body} = get(console, "/tiles/0/0/0", [])
    cookie = signed_in(console)
    assert {200, %{"content-type" => "image/png"}, "world"} = get(console, "/tiles/0/0/0", cookie)

    for path <- ["/tiles/1/0/0", "/tiles/-1/0/0", "/tiles/0/0/x", "/tiles/0/0/99999999999"],
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
    gateway = make_ref()
    log = capture_log(fn -> start_supervised!({Tiles, gateway: gateway, path: dir, attribution: nil}) end)
    assert log =~ "expected a PMTiles file, or a folder"
    assert Tiles.description(gateway) == nil
  end
end
