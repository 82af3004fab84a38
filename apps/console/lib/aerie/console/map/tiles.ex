defmodule Aerie.Console.Map.Tiles do
  @moduledoc """
  The operator's own map tiles (`console.tiles`): a PMTiles file or a folder, examined once at start and served at
  `/tiles/Z/X/Y` to signed-in users. If they cannot be used, that is logged and the map does without them.
  """
  use GenServer

  require Logger

  alias Aerie.Base.Names
  alias Aerie.Console.Map.PMTiles

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
  @type t :: %{source: PMTiles.t() | {Path.t(), String.t()}, type: String.t(), gzip?: boolean(), shown: map()}

  @doc "Options: `:gateway`, `:path` (nil: none), `:attribution`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :console_tiles))

  @doc "The map's description of the tiles (`tiles` of `Aerie.Console.Map.map/1`); nil without any."
  @spec description(Names.gateway()) :: map() | nil
  def description(gateway), do: with(%{shown: shown} <- Names.value(gateway, :console_tiles), do: shown)

  @doc "A tile with its content type and whether it is compressed, or nil."
  @spec tile(Names.gateway(), integer(), integer(), integer()) ::
          {binary(), String.t(), gzip? :: boolean()} | nil
  def tile(gateway, z, x, y) do
    with %{source: source, type: type, gzip?: gzip?} <- Names.value(gateway, :console_tiles),
         {:ok, <<_, _::binary>> = bytes} <- read(source, z, x, y) do
      {bytes, type, gzip?}
    else
      _none -> nil
    end
  end

  defp read(%PMTiles{} = source, z, x, y), do: PMTiles.tile(source, z, x, y)
  defp read({folder, ending}, z, x, y), do: File.read(Path.join([folder, "#{z}", "#{x}", "#{y}.#{ending}"]))

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

  defp file(path) do
    with {:ok, tiles} <- PMTiles.open(path) do
      {type, content} =
        case tiles.type do
          :vector -> @formats["pbf"]
          image -> {"raster", "image/#{image}"}
        end

      shown = %{
        minzoom: tiles.min_zoom,
        maxzoom: tiles.max_zoom,
        bounds: area(tiles.bounds),
        layers: tiles.layers
      }

      {:ok, tiles(tiles, type, content, tiles.tile_gzip?, shown)}
    end
  end

  # Many writers omit it.
  defp area([west, south, east, north] = bounds), do: if(west < east and south < north, do: bounds)

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
      shown = %{minzoom: low, maxzoom: high, layers: if(type == "vector", do: @common, else: [])}
      {:ok, tiles({path, ending}, type, content, gzip?, shown)}
    else
      _no_tiles -> {:error, "expected a PMTiles file, or a folder of Z/X/Y.png, .jpg, .webp or .pbf"}
    end
  end

  defp tiles(source, type, content, gzip?, shown) do
    shown = Map.merge(%{type: type, url: "/tiles/{z}/{x}/{y}"}, shown)
    %{source: source, type: content, gzip?: gzip?, shown: shown}
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
