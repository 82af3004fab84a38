defmodule Aerie.Console.Map.Tiles do
  @moduledoc """
  The operator's own map tiles (`console.tiles`), served to signed-in users: a folder, whose tiles are at
  `/tiles/Z/X/Y`, or a PMTiles file, which pages read in ranges from `/tiles/archive`. They are looked at once at
  start; if they cannot be used, that is logged and the map does without them.
  """
  use GenServer

  require Logger

  alias Aerie.Base.Names

  @formats %{
    "png" => {"raster", "image/png"},
    "jpg" => {"raster", "image/jpeg"},
    "webp" => {"raster", "image/webp"},
    "pbf" => {"vector", "application/x-protobuf"}
  }
  # The layers of both common schemas; a folder does not say which layers its vector tiles have.
  @common ~w(earth land landcover landuse park water ocean waterway transportation roads building buildings boundary boundaries)
  @max_zoom 24

  @typedoc "`:source`: the file, or the folder with the extension of its files; `:shown`: what the map gets."
  @type t :: %{
          source: {:archive, Path.t()} | {Path.t(), String.t()},
          type: String.t(),
          gzip?: boolean(),
          shown: map()
        }

  @doc "Options: `:gateway`, `:path` (nil: none), `:attribution`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :console_tiles))

  @doc "The map's description of the tiles (`tiles` of `Aerie.Console.Map.map/1`); nil without any."
  @spec description(Names.gateway()) :: map() | nil
  def description(gateway), do: with(%{shown: shown} <- Names.value(gateway, :console_tiles), do: shown)

  @doc "A tile of a folder with its content type and whether it is compressed, or nil."
  @spec tile(Names.gateway(), integer(), integer(), integer()) ::
          {binary(), String.t(), gzip? :: boolean()} | nil
  def tile(gateway, z, x, y) do
    with %{source: {"" <> folder, ending}, type: type, gzip?: gzip?} <- Names.value(gateway, :console_tiles),
         {:ok, <<_, _::binary>> = bytes} <- File.read(Path.join([folder, "#{z}", "#{x}", "#{y}.#{ending}"])) do
      {bytes, type, gzip?}
    else
      _none -> nil
    end
  end

  @doc "The PMTiles file, or nil."
  @spec archive(Names.gateway()) :: Path.t() | nil
  def archive(gateway) do
    with %{source: source} <- Names.value(gateway, :console_tiles),
         do: if(match?({:archive, _path}, source), do: elem(source, 1))
  end

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:console_tiles, gateway})
    Names.put_value(gateway, :console_tiles, open(options[:path], options[:attribution]))
    {:ok, gateway}
  end

  defp open(nil, _attribution), do: nil

  defp open(path, attribution) do
    case if(File.dir?(path), do: folder(path), else: file(path)) do
      {:ok, tiles} ->
        put_in(tiles.shown[:attribution], attribution)

      {:error, reason} ->
        Logger.warning("console.tiles: #{path}: #{reason}; the map does without tiles")
        nil
    end
  end

  # Everything else about it is found out by the pages that read it.
  defp file(path) do
    case File.open(path, [:read, :binary], &IO.binread(&1, 8)) do
      {:ok, <<"PMTiles", 3>>} ->
        {:ok, %{source: {:archive, path}, type: nil, gzip?: false, shown: %{archive: "/tiles/archive"}}}

      {:ok, <<"PMTiles", version>>} ->
        {:error, "it is PMTiles version #{version}; only version 3 is supported"}

      {:ok, _other} ->
        {:error, "it is not a PMTiles file"}

      {:error, reason} ->
        {:error, "#{:file.format_error(reason)}"}
    end
  end

  defp folder(path) do
    zooms =
      for name <- list(path), {z, ""} when z in 0..@max_zoom <- [Integer.parse(name)], do: z

    with [_ | _] <- zooms,
         first = Path.join(path, Integer.to_string(Enum.max(zooms))),
         [column | _] <- list(first),
         [tile | _] <- list(Path.join(first, column)),
         "." <> ending <- Path.extname(tile),
         %{^ending => {type, content}} <- @formats do
      {low, high} = Enum.min_max(zooms)
      gzip? = type == "vector" and match?(<<31, 139, _::binary>>, start(Path.join([first, column, tile])))
      layers = if type == "vector", do: @common, else: []
      shown = %{type: type, url: "/tiles/{z}/{x}/{y}", minzoom: low, maxzoom: high, layers: layers}
      {:ok, %{source: {path, ending}, type: content, gzip?: gzip?, shown: shown}}
    else
      _no_tiles -> {:error, "expected a PMTiles file, or a folder of Z/X/Y.png, .jpg, .webp or .pbf"}
    end
  end

  defp list(folder) do
    case File.ls(folder) do
      {:ok, names} -> Enum.sort(names)
      {:error, _reason} -> []
    end
  end

  defp start(path) do
    with {:ok, bytes} <- File.read(path), do: bytes
  end
end
