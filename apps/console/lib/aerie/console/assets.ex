defmodule Aerie.Console.Assets do
  @moduledoc """
  The scripts, styles and images of the pages, in memory: Aerie's own (`assets/`) and those of npm packages. They are
  read once at start, so that a page never mixes two versions. Large ones wait in their open files until somebody
  wants them; then they are kept compressed.

  Their addresses contain a hash of all of them, `/assets/HASH/console.js`, so that browsers may cache them for ever and
  modules find each other by relative paths.

  In a checkout they come from `apps/console/assets` and `node_modules`, in a release from the same two folders in `priv/console`.
  """
  use GenServer

  alias Aerie.Base.Names

  @checkout Path.expand("../../..", __DIR__)
  @npm [
    {"@fontsource-variable/inter", "files", ~w(inter-latin-wght-normal.woff2)},
    {"phoenix", "priv/static", ~w(phoenix.mjs)},
    {"phoenix_live_view", "priv/static", ~w(phoenix_live_view.esm.js)},
    {"@protomaps/basemaps", "dist/esm", ~w(index.js)},
    {"pmtiles", "dist", ~w(pmtiles.js)},
    {"maplibre-gl", "dist", ~w(maplibre-gl.mjs maplibre-gl-worker.mjs)},
    {"world-atlas", "", ~w(countries-50m.json countries-10m.json)},
    {"topojson-client", "src", ~w(feature.js mesh.js stitch.js reverse.js transform.js identity.js)},
    {"uplot", "dist", ~w(uPlot.esm.js uPlot.iife.min.js uPlot.min.css)}
  ]
  @types %{
    ".js" => "text/javascript; charset=utf-8",
    ".mjs" => "text/javascript; charset=utf-8",
    ".css" => "text/css; charset=utf-8",
    ".json" => "application/json",
    ".svg" => "image/svg+xml",
    ".png" => "image/png",
    ".woff2" => "font/woff2"
  }

  # Larger ones wait in their files.
  @small 131_072
  # A slow processor needs seconds for the largest one.
  @pack_ms 60_000

  @typedoc "`gzip` is nil if compression does not make it smaller; `plain` is nil if it was large and does."
  @type asset :: %{type: String.t(), etag: String.t(), plain: binary() | nil, gzip: binary() | nil}

  @doc "Options: `:gateway`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :console_assets))

  @doc "The address of an asset: `path(gateway, \"console.js\")`."
  @spec path(Names.gateway(), String.t()) :: String.t()
  def path(gateway, name) do
    case Names.value(gateway, :console_assets) do
      {_table, hash, _styles, _missing} -> "/assets/#{hash}/#{name}"
      nil -> "/assets/0/#{name}"
    end
  end

  @doc "The style sheets in the order of precedence: tokens, base, ui, then the pages' own."
  @spec styles(Names.gateway()) :: [String.t()]
  def styles(gateway),
    do: Names.read(gateway, :console_assets, [], fn {_table, _hash, styles, _missing} -> styles end)

  @doc "The npm packages that are not installed; without them pages are shown, but do not update."
  @spec missing(Names.gateway()) :: [String.t()]
  def missing(gateway),
    do: Names.read(gateway, :console_assets, [], fn {_table, _hash, _styles, missing} -> missing end)

  @doc "The font's name. Pages ask for it before the style sheets do, so that texts keep their widths."
  @spec font() :: String.t()
  def font, do: "npm/@fontsource-variable/inter/inter-latin-wght-normal.woff2"

  @doc "The hash in the addresses."
  @spec version(Names.gateway()) :: String.t() | nil
  def version(gateway),
    do: Names.read(gateway, :console_assets, nil, fn {_table, hash, _styles, _missing} -> hash end)

  @doc "An asset by its name; only assets that were found at start exist."
  @spec find(Names.gateway(), String.t()) :: asset() | nil
  def find(gateway, name) do
    found =
      Names.read(gateway, :console_assets, nil, fn {table, _hash, _styles, _missing} ->
        :ets.lookup_element(table, name, 2, nil)
      end)

    with %{gzip: :later} <- found,
         do: GenServer.call(Names.via(gateway, :console_assets), {:pack, name}, @pack_ms)
  end

  @doc "The content of an asset by its name, also where no gateway runs."
  @spec read(String.t()) :: {:ok, binary()} | {:error, :enoent | File.posix()}
  def read(name) do
    {found, _missing} = files()
    with {^name, path} <- List.keyfind(found, name, 0, {:error, :enoent}), do: File.read(path)
  end

  @doc "Copies all of them to where a release has them. Returns the npm packages that are not installed."
  @spec pack(Path.t()) :: [String.t()]
  def pack(release) do
    {found, missing} = files()

    for {name, source} <- found do
      target = Path.join([release, "priv/console", target(name)])
      File.mkdir_p!(Path.dirname(target))
      File.cp!(source, target)
    end

    missing
  end

  # The name of a package may have a folder.
  defp target("npm/" <> name) do
    {package, folder, _files} =
      Enum.find(@npm, fn {package, _folder, _files} -> String.starts_with?(name, package <> "/") end)

    Path.join(["node_modules", package, folder, String.replace_prefix(name, package <> "/", "")])
  end

  defp target(name), do: Path.join("assets", name)

  @impl GenServer
  def init(options) do
    {found, missing} = files()
    table = :ets.new(:console_assets, [:set, :protected, read_concurrency: true])
    assets = for {name, path} <- found, do: {name, asset(name, path)}
    rows = for {name, {asset, _file}} <- assets, do: {name, asset}
    true = :ets.insert(table, rows)

    hash = for({name, asset} <- rows, do: [name, asset.etag]) |> digest()
    names = for "css/" <> _style = name <- Enum.map(rows, &elem(&1, 0)), do: name
    first = ~w(css/tokens.css css/base.css css/ui.css)
    styles = first ++ Enum.sort(names -- first)
    Names.put_value(options[:gateway], :console_assets, {table, hash, styles, missing})
    large = for {name, {_asset, file}} when file != nil <- assets, into: %{}, do: {name, file}
    {:ok, %{table: table, large: large}, :hibernate}
  end

  defp asset(name, path) do
    plain = File.read!(path)
    type = Map.fetch!(@types, Path.extname(name))
    asset = %{type: type, etag: ~s("#{digest(plain)}"), plain: plain, gzip: :later}

    if byte_size(plain) > @small,
      do: {%{asset | plain: nil}, {File.open!(path, [:raw, :binary]), byte_size(plain)}},
      else: {asset, nil}
  end

  @impl GenServer
  def handle_call({:pack, name}, _from, %{table: table, large: large} = state) do
    # Another request may have packed it in the meantime.
    asset = :ets.lookup_element(table, name, 2)
    asset = if asset.gzip == :later, do: packed(asset, large[name]), else: asset
    if asset, do: :ets.insert(table, {name, asset})
    {:reply, asset, state, :hibernate}
  end

  defp packed(asset, nil), do: %{asset | gzip: smaller(asset.plain)}

  # Nothing is found if the disk is gone.
  defp packed(asset, {file, size}) do
    with {:ok, plain} <- :file.pread(file, 0, size) do
      gzip = smaller(plain)
      %{asset | gzip: gzip, plain: if(gzip == nil, do: plain)}
    else
      _unreadable -> nil
    end
  end

  # Images are compressed already.
  defp smaller(plain) do
    gzip = :zlib.gzip(plain)
    if byte_size(gzip) < byte_size(plain) * 9 / 10, do: gzip
  end

  defp digest(data) do
    <<short::binary-9, _rest::binary>> = :crypto.hash(:sha256, data)
    Base.url_encode64(short)
  end

  # Sorted by name, so that the hash depends only on the files.
  defp files do
    {own, modules} = folders()

    found =
      for path <- Path.wildcard(own <> "/**/*"),
          Map.has_key?(@types, Path.extname(path)),
          do: {Path.relative_to(path, own), path}

    npm =
      for {package, folder, files} <- @npm,
          file <- files,
          do: {package, "npm/#{package}/#{file}", Path.join([modules, package, folder, file])}

    {there, absent} = Enum.split_with(npm, fn {_package, _name, path} -> File.regular?(path) end)

    {found ++ for({_package, name, path} <- there, do: {name, path}),
     absent |> Enum.map(&elem(&1, 0)) |> Enum.uniq()}
  end

  defp folders do
    packed = Application.app_dir(:console, "priv/console")

    if File.dir?(packed),
      do: {Path.join(packed, "assets"), Path.join(packed, "node_modules")},
      else: {Path.join(@checkout, "assets"), Path.expand("../../node_modules", @checkout)}
  end
end
