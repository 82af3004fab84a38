defmodule Aerie.Console.Map.TilesTest do
  use Aerie.ConsoleCase, async: true

  import Aerie.MapPage, only: [browse_map: 2, browse_map: 3, browse_map: 4]
  import ExUnit.CaptureLog

  alias Aerie.Base.Names
  alias Aerie.Console.Map.Tiles
  alias Aerie.TileServer

  @moduletag :tmp_dir
  @png Aerie.TileServer.png()

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

  # A vector tile (Mapbox's specification, version 2.1): the layer `water`, whose one polygon is all of it, and a town.
  defp vectors do
    zigzag = fn n -> Bitwise.bxor(Bitwise.bsl(n, 1), Bitwise.bsr(n, 63)) end
    all = [9, 0, 0, 26, zigzag.(4096), 0, 0, zigzag.(4096), zigzag.(-4096), 0, 15]
    town = [{"kind", "locality"}, {"name", "Uster"}, {"min_zoom", 3}, {"population_rank", 12}]
    layer("water", 3, all, []) <> layer("places", 1, [9, zigzag.(2048), zigzag.(2048)], town)
  end

  defp layer(name, type, moves, facts) do
    keys = for {key, _value} <- facts, into: "", do: bytes(3, key)
    values = for {_key, value} <- facts, into: "", do: bytes(4, value(value))
    tags = for {_fact, n} <- Enum.with_index(facts), into: "", do: varint(n) <> varint(n)
    feature = bytes(2, tags) <> <<24, type>> <> bytes(4, for(n <- moves, into: "", do: varint(n)))
    bytes(3, bytes(1, name) <> bytes(2, feature) <> keys <> values <> <<40>> <> varint(4096) <> <<120, 2>>)
  end

  defp value(text) when is_binary(text), do: bytes(1, text)
  defp value(number), do: <<40>> <> varint(number)
  defp bytes(field, value), do: <<field * 8 + 2>> <> varint(byte_size(value)) <> value

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

  defp signed_in(console, who \\ :viewer) do
    session =
      Aerie.Access.Session.of_user(
        console.gateway,
        Aerie.Access.Users.find(console.gateway, Atom.to_string(who))
      )

    %{secret: secret, cookie: name} = console.server
    [{~c"cookie", ~c"#{name}=#{Phoenix.LiveView.Token.sign(secret, "cookie", session)}"}]
  end

  defp layer(more),
    do: Map.merge(%{id: "own", kind: :raster, url: nil, file: nil, min_zoom: 0, max_zoom: 19}, more)

  defp start(dir, layers, more \\ %{}) do
    map = Map.merge(%{layers: Enum.map(layers, &layer/1), dir: Path.join(dir, "map")}, more)

    [console: console] =
      start_console(config: %{console: %{dir: Path.join(dir, "c"), map: map}}, dir: Path.join(dir, "c"))

    console
  end

  defp description(console, who \\ :viewer) do
    {200, %{"cache-control" => "no-store"}, json} = get(console, "/tiles", signed_in(console, who))
    JSON.decode!(json)
  end

  defp answer(console, who, json, more \\ []) do
    {:ok, {{_, status, _}, _headers, body}} =
      :httpc.request(
        :post,
        {~c"#{console.url}/tiles", more ++ signed_in(console, who), ~c"application/json", json},
        [],
        []
      )

    {status, to_string(body)}
  end

  test "ranges of a PMTiles file go to signed-in users, and the map knows its address", %{tmp_dir: dir} do
    whole = pmtiles(2, "tile!")
    path = file(dir, whole)
    console = start(dir, [%{file: path, name: "Field", attribution: "(c) me"}])

    assert description(console) == %{
             "ask" => false,
             "openstreetmap" => nil,
             "fixed" => false,
             "may" => false,
             "layers" => [
               %{
                 "id" => "own",
                 "name" => "Field",
                 "attribution" => "(c) me",
                 "archive" => "/tiles/own",
                 "prepares" => false,
                 "areas" => [],
                 "minzoom" => 0,
                 "maxzoom" => 0
               }
             ]
           }

    assert {401, _headers, _body} = get(console, "/tiles", [])
    assert {401, _headers, _body} = get(console, "/tiles/own", range("0-9"))
    cookie = signed_in(console)
    get = fn range -> get(console, "/tiles/own", range(range) ++ cookie) end

    assert {206, %{"content-range" => range, "etag" => etag}, <<"PMTiles", 3, _::binary-2>>} = get.("0-9")
    assert range == "bytes 0-9/#{byte_size(whole)}"
    last = byte_size(whole) - 1
    assert {206, %{"etag" => ^etag}, "tile!"} = get.("#{last - 4}-#{last + 1_000}")

    # Several, from the end, without an end, beyond it, too long, and no range at all.
    for range <- ["0-1,3-4", "-5", "0-", "#{last + 1}-#{last + 9}", "9-0", "x", "0-99999999999"] do
      expected = if range == "0-99999999999", do: 206, else: 416
      assert {^expected, _headers, _body} = get.(range)
    end

    assert {416, _headers, "ask for one range" <> _} = get(console, "/tiles/own", cookie)
    File.write!(path, whole <> String.duplicate("x", 20_000_000))
    assert {416, _headers, _body} = get.("0-17000000")
    File.rm!(path)
    assert {404, _headers, _body} = get.("0-9")

    for path <- ["/tiles/own/0/0/0", "/tiles/osm", "/tiles/x"],
        do: assert({404, _, _} = get(console, path, cookie))
  end

  describe "in a browser" do
    @describetag :chromium

    test "a PMTiles file of vectors is drawn in the style of Protomaps, light and dark, with our font", %{
      tmp_dir: dir
    } do
      metadata = JSON.encode!(%{vector_layers: [%{id: "water"}, %{id: "places"}, %{id: "waterway"}]})
      console = start(dir, [%{file: file(dir, pmtiles(1, vectors(), metadata))}])
      assert browse_map(console, "tiles", ["vector"]) =~ "ok"
    end

    test "a PMTiles file of images is drawn", %{tmp_dir: dir} do
      console = start(dir, [%{file: file(dir, pmtiles(2, @png))}])
      assert browse_map(console, "tiles", ["raster"]) =~ "ok"
    end

    test "one that is damaged behind its header is left out, and the browser's log says so", %{tmp_dir: dir} do
      whole = pmtiles(1, vectors())
      <<header::binary-127, rest::binary>> = whole
      console = start(dir, [%{file: file(dir, header <> String.duplicate("x", byte_size(rest)))}])
      assert browse_map(console, "notiles") =~ "ok"
    end

    test "an admin says yes to OpenStreetMap, a choice is remembered, and the page asks only the gateway",
         %{tmp_dir: dir} do
      console = start(dir, [])
      osm(console, TileServer.start() <> "/{z}/{x}/{y}.png")
      assert browse_map(console, "base", ["admin"], :admin) =~ "ok"
      # The gateway itself has asked.
      assert_received {:asked, "/" <> _tile, %{"user-agent" => "Aerie/" <> _version}}
      assert browse_map(console, "layers", ["OpenStreetMap"]) =~ "ok"
    end

    test "an admin opens a file of this machine", %{tmp_dir: dir} do
      path = file(dir, pmtiles(2, @png), "own")
      assert browse_map(start(dir, []), "upload", [path], :admin) =~ "ok"
    end

    test "an admin prepares the area in view", %{tmp_dir: dir} do
      console = start(dir, [%{url: TileServer.start() <> "/{z}/{x}/{y}"}])
      assert browse_map(console, "area", [], :admin) =~ "ok"
    end

    test "an operator reads that an admin can choose", %{tmp_dir: dir} do
      assert browse_map(start(dir, []), "base", ["operator"]) =~ "ok"
    end

    test "the map says that tiles cannot be fetched", %{tmp_dir: dir} do
      url = TileServer.start(fn _asked -> {500, %{}, "no"} end)
      console = start(dir, [%{url: url <> "/{z}/{x}/{y}"}])
      assert browse_map(console, "missing") =~ "ok"
    end
  end

  # No test asks the real one.
  defp osm(console, url) do
    :sys.replace_state(Aerie.Base.Names.whereis(console.gateway, :console_tiles), &%{&1 | osm: url})
  end

  defp range(text), do: [{~c"range", ~c"bytes=#{text}"}]

  test "tiles of a folder go to signed-in users", %{tmp_dir: dir} do
    File.mkdir_p!(Path.join(dir, "tiles/0/0"))
    File.write!(Path.join(dir, "tiles/0/0/0.png"), "world")
    console = start(dir, [%{file: Path.join(dir, "tiles")}])

    assert %{layers: [%{type: "raster", url: "/tiles/own/{z}/{x}/{y}", maxzoom: 0}]} =
             Tiles.description(console.gateway)

    assert {401, _headers, _body} = get(console, "/tiles/own/0/0/0", [])
    cookie = signed_in(console)
    assert {200, %{"content-type" => "image/png"}, "world"} = get(console, "/tiles/own/0/0/0", cookie)

    for path <- ~w(own own/1/0/0 own/-1/0/0 own/0/0/x own/0/0/99999999999 other/0/0/0 ../0/0/0),
        do: assert({404, _, _} = get(console, "/tiles/" <> path, cookie))
  end

  test "what holds no tiles is said, and the map goes on without", %{tmp_dir: dir} do
    whole = pmtiles(2, "tile!")

    for {given, reason} <- [
          {%{file: dir}, "expected a PMTiles file, or a folder"},
          {%{file: file(dir, "PMTile", "short")}, "it is not a PMTiles file"},
          {%{file: file(dir, <<"PMTiles", 2>>, "old")},
           "it is PMTiles version 2; only version 3 is supported"},
          {%{file: file(dir, <<"PMTiles", 3>>, "head")}, "it is cut off after 8 bytes"},
          {%{file: file(dir, binary_part(whole, 0, byte_size(whole) - 1), "cut")}, "it is cut off: "},
          {%{file: file(dir, pmtiles(9, "x"), "odd")}, "its tiles are of an unknown type (9)"},
          {%{file: Path.join(dir, "nowhere")}, "no such file"},
          {%{url: "http://a/{z}/{x}/{y}/{key}", key_file: Path.join(dir, "nokey")}, "there is no such file"},
          {%{url: "http://a/{z}/{x}/{y}/{key}", key_file: open_file(dir)}, "others can read it"}
        ] do
      gateway = make_ref()

      settings = %{
        layers: [layer(given)],
        openstreetmap: false,
        dir: Path.join(dir, "map"),
        cache_mb: 10,
        upload_mb: 1
      }

      log =
        capture_log(fn -> start_supervised!({Tiles, gateway: gateway, settings: settings}, id: gateway) end)

      assert log =~ reason
      assert %{layers: [], ask: false} = Tiles.description(gateway)
      assert Tiles.archive(gateway, "own") == nil
    end
  end

  defp open_file(dir) do
    path = Path.join(dir, "open")
    File.write!(path, "key")
    File.chmod!(path, 0o644)
    path
  end

  test "tiles of a server: fetched once, kept, asked for by ETag, shown when the server is gone",
       %{tmp_dir: dir} do
    key = Path.join(dir, "key")
    File.write!(key, "s3cret\n")
    File.chmod!(key, 0o600)
    status = :atomics.new(1, [])
    headers = %{"etag" => ~s("1"), "cache-control" => "max-age=1"}

    url =
      TileServer.start(fn {_path, asked} ->
        cond do
          :atomics.get(status, 1) == 1 -> {500, %{}, "s3cret is wrong"}
          asked["if-none-match"] == ~s("1") -> {304, headers, ""}
          true -> {200, headers, @png}
        end
      end)

    console = start(dir, [%{url: url <> "/t/{z}/{x}/{y}.png?key={key}", key_file: key, max_zoom: 5}])
    cookie = signed_in(console)
    get = fn path -> get(console, "/tiles/own/" <> path, cookie) end

    assert {200, %{"content-type" => "image/png", "x-content-type-options" => "nosniff"}, @png} =
             get.("1/0/1")

    assert_received {:asked, "/t/1/0/1.png?key=s3cret", %{"user-agent" => "Aerie/" <> _}}
    assert {200, _headers, @png} = get.("1/0/1")
    refute_received {:asked, _path, _headers}

    # Neither beyond its zooms, nor beside the earth, nor anything else of the server.
    for path <- ~w(6/0/0 1/2/0 1/0/2 0/0/0/0 0/0/0.png), do: assert({404, _, _} = get.(path))
    refute_received {:asked, _path, _headers}

    [path] = Path.wildcard(Path.join(dir, "map/cache/*/1/0/1"))
    age = fn -> File.write!(path, path |> File.read!() |> String.replace(~r/"until":\d+/, ~s("until":1))) end
    age.()
    assert {200, _headers, @png} = get.("1/0/1")
    assert_received {:asked, _path, %{"if-none-match" => ~s("1")}}
    assert {200, _headers, @png} = get.("1/0/1")
    refute_received {:asked, _path, _headers}

    age.()
    :atomics.put(status, 1, 1)

    log =
      capture_log(fn ->
        assert {200, _headers, @png} = get.("1/0/1")
        assert {502, _headers, text} = get.("1/1/1")
        assert text =~ "it answered 500"
        refute text =~ "s3cret"
      end)

    assert log =~ "it answered 500"
    refute log =~ "s3cret"
    refute JSON.encode!(description(console)) =~ "s3cret"
    assert %{servers: servers} = status = Tiles.Fetcher.status(console.gateway)
    refute inspect(status, limit: :infinity) =~ "s3cret"
    assert [%{fetched: 2, errors: 1}] = Map.values(servers)
  end

  test "OpenStreetMap waits for an admin, whose answer is kept and in the audit log", %{tmp_dir: dir} do
    console = start(dir, [])
    assert %{"layers" => [], "ask" => true, "may" => false} = description(console, :operator)
    assert %{"ask" => true, "may" => true} = description(console, :admin)
    assert {404, _headers, _body} = get(console, "/tiles/osm/0/0/0", signed_in(console))

    yes = ~s({"openstreetmap": true})
    for who <- [:viewer, :operator], do: assert({403, "an admin chooses" <> _} = answer(console, who, yes))
    assert {403, _words} = answer(console, :admin, yes, [{~c"origin", ~c"https://evil.example"}])

    for {odd, expected} <- [
          {"{}", 400},
          {"[", 400},
          {~s({"openstreetmap": "yes"}), 400},
          {String.duplicate("x", 2_000), 413}
        ],
        do: assert({^expected, _words} = answer(console, :admin, odd))

    assert description(console, :admin)["ask"]

    osm(console, TileServer.start() <> "/{z}/{x}/{y}.png")
    assert {200, _words} = answer(console, :admin, yes)

    assert %{"ask" => false, "layers" => [%{"id" => "osm", "attribution" => "© OpenStreetMap contributors"}]} =
             description(console)

    assert {200, _headers, @png} = get(console, "/tiles/osm/0/0/0", signed_in(console))
    assert {200, _words} = answer(console, :admin, ~s({"openstreetmap": false}))
    assert %{"ask" => false, "layers" => []} = description(console)
    assert {404, _headers, _body} = get(console, "/tiles/osm/0/0/0", signed_in(console))

    # After a restart it is known.
    stop_supervised!({:endpoint, console.gateway})
    gateway = make_ref()
    settings = %{layers: [], openstreetmap: nil, dir: Path.join(dir, "map"), cache_mb: 10, upload_mb: 1}
    start_supervised!({Tiles, gateway: gateway, settings: settings})
    assert %{layers: [], ask: false} = Tiles.description(gateway)
  end

  test "the settings say what is kept of each layer, and empty it; only for admins", %{tmp_dir: dir} do
    status = :atomics.new(1, [])

    url =
      TileServer.start(fn _asked ->
        if :atomics.get(status, 1) == 1, do: {503, %{}, "no"}, else: {200, %{}, @png}
      end)

    console = start(dir, [%{url: url <> "/{z}/{x}/{y}", name: "Photos"}])
    cookie = signed_in(console)
    for y <- 0..1, do: assert({200, _headers, @png} = get(console, "/tiles/own/1/0/#{y}", cookie))
    eventually(fn -> Tiles.Fetcher.status(console.gateway).held != nil end)

    for who <- [:viewer, :operator] do
      {:ok, view, html} = live(conn(console, who), "/settings?part=map")
      refute html =~ "Photos"
      render_hook(view, "clear-map", %{"name" => "own"})
      assert {200, _headers, @png} = get(console, "/tiles/own/1/0/0", cookie)
    end

    {:ok, view, html} = live(conn(console, :admin), "/settings?part=map")
    assert html =~ "Photos"
    row = fn -> view |> element("#layer-own") |> render() end
    eventually(fn -> row.() =~ ~r/2, 0\.\d MB/ and row.() =~ "Answers" end)
    :atomics.put(status, 1, 1)
    capture_log(fn -> assert {502, _headers, _body} = get(console, "/tiles/own/2/0/0", cookie) end)
    send(view.pid, :refresh)
    assert row.() =~ ~r/Failing: it answered 503.*Asked again in \d+ s/

    # No other layer than a server's, and none that is not there.
    for id <- ["other", "../files"],
        do: assert({:error, "nothing is kept" <> _} = Tiles.clear(console.gateway, id, by()))

    view |> element("#layer-own button", "Empty") |> render_click()
    assert view |> element("#clear-map button.danger") |> render_click() =~ "is removed"
    assert Path.wildcard(Path.join(dir, "map/cache/*/*/*/*")) == []
    assert row.() =~ "0, 0.0 MB"
  end

  test "an admin prepares an area: its size first, then its tiles, which pages have without the server", %{
    tmp_dir: dir
  } do
    console = start(dir, [%{url: TileServer.start() <> "/{z}/{x}/{y}", max_zoom: 14}])
    osm(console, "https://tile.openstreetmap.org/{z}/{x}/{y}.png")
    assert {200, _words} = answer(console, :admin, ~s({"openstreetmap": true}))
    assert [%{"prepares" => true}, %{"id" => "osm", "prepares" => false}] = description(console)["layers"]
    ask = &area(console, &1, :post, &2, JSON.encode!(%{box: [8.5, 47.3, 8.6, 47.4], zoom: 20, begin: &3}))

    for who <- [:viewer, :operator],
        method <- [:get, :post, :delete],
        do: assert({403, "an admin prepares" <> _} = area(console, who, method, "own", "{}"))

    for id <- ~w(osm other), do: assert({409, "areas of this layer cannot" <> _} = ask.(:admin, id, true))

    for odd <- [
          "{}",
          "[",
          ~s({"box": [1, 2, 3, "4"], "zoom": 3, "begin": true}),
          ~s({"box": [1,2,3,4], "zoom": 99, "begin": true})
        ],
        do: assert({400, _words} = area(console, :admin, :post, "own", odd))

    assert {409, "the area must lie" <> _} =
             area(console, :admin, :post, "own", ~s({"box": [9, 1, 8, 2], "zoom": 3, "begin": true}))

    assert {200, "null"} = area(console, :admin, :get, "own", "")
    assert {200, size} = ask.(:admin, "own", false)
    assert %{"tiles" => tiles, "bytes" => bytes} = JSON.decode!(size)
    assert bytes == tiles * 20_000
    refute_received {:asked, _path, _headers}

    assert {200, _size} = ask.(:admin, "own", true)
    status = fn -> console |> area(:admin, :get, "own", "") |> elem(1) |> JSON.decode!() end
    eventually(fn -> status.()["ended"] == "done" end)
    assert %{"layer" => "own", "total" => ^tiles, "done" => ^tiles} = status.()
    assert length(Path.wildcard(Path.join(dir, "map/cache/own-*/*/*/*"))) == tiles
    # Its own zooms only, and all of them.
    assert dir |> Path.join("map/cache/own-*/*") |> Path.wildcard() |> length() == 15

    # All maps show where it is, also after a restart; an admin takes it off the list, and only once it is all there.
    listed = fn -> for(%{"id" => "own", "areas" => areas} <- description(console)["layers"], do: areas) end
    eventually(fn -> listed.() == [[%{"box" => [8.5, 47.3, 8.6, 47.4], "zoom" => 14}]] end)
    assert {200, _size} = ask.(:admin, "own", true)
    tiles_process = Names.whereis(console.gateway, :console_tiles)
    eventually(fn -> status.()["ended"] == "done" end)
    Process.exit(tiles_process, :kill)
    eventually(fn -> match?([[_one]], listed.()) and Tiles.areas(console.gateway) != [] end)
    {:ok, view, _html} = live(conn(console, :admin), "/settings?part=map")
    assert view |> element("#map-areas tbody") |> render() =~ "47.35, 8.55"
    [%{at: at}] = Tiles.areas(console.gateway)
    for odd <- ["1", "x", ""], do: render_hook(view, "forget-area", %{"at" => odd})
    assert [_still] = Tiles.areas(console.gateway)
    {:ok, stranger, _html} = live(conn(console, :operator), "/settings")
    render_hook(stranger, "forget-area", %{"at" => "#{at}"})
    assert [_still] = Tiles.areas(console.gateway)
    view |> element("#area-#{at} button", "Forget") |> render_click()
    refute has_element?(view, "#map-areas")
    assert listed.() == [[]]
    # Its tiles stay, and what is emptied has no areas.
    assert length(Path.wildcard(Path.join(dir, "map/cache/own-*/*/*/*"))) == tiles
    assert {200, _size} = ask.(:admin, "own", true)
    eventually(fn -> match?([[_one]], listed.()) end)
    assert :ok = Tiles.clear(console.gateway, "own", by())
    assert listed.() == [[]]
    # The answer is still there.
    assert description(console)["openstreetmap"] == true
  end

  test "an area that the disk has no room for is refused; one at a time; cancel ends it", %{tmp_dir: dir} do
    test = self()

    url =
      TileServer.start(fn _asked ->
        send(test, {:held, self()})
        receive(do: (:go -> {200, %{}, @png}))
      end)

    console = start(dir, [%{url: url <> "/{z}/{x}/{y}", max_zoom: 19}], %{cache_mb: 10})
    body = &JSON.encode!(%{box: [8.5, 47.3, 8.6, 47.4], zoom: &1, begin: true})
    assert {409, words} = area(console, :admin, :post, "own", body.(18))
    assert words =~ "console.map.cache_mb"
    assert {200, _size} = area(console, :admin, :post, "own", body.(12))
    assert {409, "another area" <> _} = area(console, :admin, :post, "own", body.(12))
    assert_receive {:held, first}
    assert_receive {:held, second}
    assert {200, _words} = area(console, :admin, :delete, "own", "")
    for server <- [first, second], do: send(server, :go)

    eventually(fn ->
      area(console, :admin, :get, "own", "") |> elem(1) |> JSON.decode!() |> Map.get("ended") == "cancelled"
    end)

    refute_received {:held, _third}
  end

  defp area(console, who, method, id, body) do
    to = {~c"#{console.url}/tiles/#{id}/area", signed_in(console, who)}

    request =
      if method == :post,
        do: Tuple.insert_at(to, 2, ~c"application/json") |> Tuple.insert_at(3, body),
        else: to

    {:ok, {{_, status, _}, _headers, body}} = :httpc.request(method, request, [], [])
    {status, body |> to_string() |> String.trim()}
  end

  defp by, do: Aerie.Access.Changes.user(%{user: %{name: "a", role: :admin}, peer: {127, 0, 0, 1}})

  defp send_file(console, who, name, bytes, more \\ []) do
    type = Keyword.get(more, :type, ~c"application/vnd.pmtiles")
    headers = signed_in(console, who) ++ Keyword.get(more, :headers, [])

    {:ok, {{_, status, _}, _headers, body}} =
      :httpc.request(:put, {~c"#{console.url}/tiles/#{name}", headers, type, bytes}, [], [])

    {status, to_string(body)}
  end

  defp delete(console, who, id) do
    {:ok, {{_, status, _}, _headers, body}} =
      :httpc.request(:delete, {~c"#{console.url}/tiles/#{id}", signed_in(console, who)}, [], [])

    {status, to_string(body)}
  end

  test "an admin uploads a map file, which is a layer at once and after a restart, and removes it", %{
    tmp_dir: dir
  } do
    console = start(dir, [], %{upload_mb: 1})
    whole = pmtiles(2, "tile!")
    assert {200, _words} = send_file(console, :admin, "field", whole)

    assert %{"ask" => false, "layers" => [%{"id" => "file-field", "name" => "field", "uploaded" => true}]} =
             description(console)

    assert {206, _headers, "PMTiles"} = get(console, "/tiles/file-field", range("0-6") ++ signed_in(console))
    assert [path] = Path.wildcard(Path.join(dir, "map/files/*"))
    assert %{mode: mode} = File.stat!(path)
    assert Bitwise.band(mode, 0o777) == 0o600

    # Nothing else is taken, and nothing is left of it.
    for {status, words, who, name, bytes, more} <- [
          {403, "an admin chooses", :viewer, "b", whole, []},
          {403, "an admin chooses", :operator, "b", whole, []},
          {403, "origin", :admin, "b", whole, [headers: [{~c"origin", ~c"https://evil.example"}]]},
          {415, "application/vnd.pmtiles", :admin, "b", whole, [type: ~c"text/plain"]},
          {422, "a name has", :admin, "b.c", whole, []},
          {422, "a name has", :admin, "..%2Fb", whole, []},
          {422, "it is cut off", :admin, "b", binary_part(whole, 0, byte_size(whole) - 1), []},
          {422, "it is cut off", :admin, "b", "PMTiles" <> <<3>>, []},
          {422, "not a PMTiles file", :admin, "b", "<html>" <> whole, []},
          {422, "not a PMTiles file", :admin, "b", "", []},
          {422, "it is an MBTiles file", :admin, "b", "SQLite format 3" <> <<0>>, []},
          {413, "console.map.upload_mb", :admin, "b", whole <> String.duplicate("x", 1_000_001), []}
        ] do
      assert {^status, text} = send_file(console, who, name, bytes, more)
      assert text =~ words
      assert Path.wildcard(Path.join(dir, "map/files/*"), match_dot: true) == [path]
    end

    :ok = Aerie.Base.Names.register(console.gateway, :console_map_upload, nil)
    assert {409, "another file" <> _} = send_file(console, :admin, "b", whole)

    gateway = make_ref()
    settings = %{layers: [], openstreetmap: nil, dir: Path.join(dir, "map"), cache_mb: 10, upload_mb: 1}
    start_supervised!({Tiles, gateway: gateway, settings: settings})
    assert %{layers: [%{id: "file-field"}]} = Tiles.description(gateway)

    for who <- [:viewer, :operator], do: assert({403, _words} = delete(console, who, "file-field"))
    for id <- ~w(file-x field osm file-..%2F..%2Fmap), do: assert({409, _words} = delete(console, :admin, id))
    assert {200, _words} = delete(console, :admin, "file-field")
    assert %{"ask" => true, "layers" => []} = description(console)
    refute File.exists?(path)
  end

  test "an upload that breaks off leaves nothing in the way of the next", %{tmp_dir: dir} do
    console = start(dir, [])
    [{~c"cookie", cookie}] = signed_in(console, :admin)
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, console.port, [:binary, active: false])

    :ok =
      :gen_tcp.send(socket, [
        "PUT /tiles/a HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/vnd.pmtiles\r\n",
        "content-length: 5000000\r\ncookie: ",
        cookie,
        "\r\n\r\nPMTiles",
        String.duplicate("x", 2_000_000)
      ])

    part = Path.join(dir, "map/files/.upload")
    eventually(fn -> match?({:ok, %{size: size}} when size > 0, File.stat(part)) end)
    :gen_tcp.close(socket)
    eventually(fn -> match?({200, _words}, send_file(console, :admin, "a", pmtiles(2, "tile!"))) end)
    assert [%{"id" => "file-a"}] = description(console)["layers"]
  end

  test "what the configuration says about OpenStreetMap is not changed here", %{tmp_dir: dir} do
    console = start(dir, [], %{openstreetmap: false})
    assert %{"ask" => false, "layers" => []} = description(console, :admin)
    assert {409, "console.map.openstreetmap" <> _} = answer(console, :admin, ~s({"openstreetmap": true}))
  end
end
