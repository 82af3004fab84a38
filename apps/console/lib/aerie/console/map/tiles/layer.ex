defmodule Aerie.Console.Map.Tiles.Layer do
  @moduledoc """
  One map that the operator can choose: a server's tiles, a PMTiles file, or a folder of tiles. `shown` is what pages
  learn of it, which is never where it comes from. Files are looked at when the layer is made.
  """

  alias Aerie.Access.PrivateFile
  alias Aerie.Base.Secret
  alias Aerie.Console.Map.Tiles.Pmtiles

  @formats %{
    "png" => {"raster", "image/png"},
    "jpg" => {"raster", "image/jpeg"},
    "webp" => {"raster", "image/webp"},
    "pbf" => {"vector", "application/x-protobuf"}
  }
  @max_zoom 24
  @max_key 1_024

  @enforce_keys [:id, :source, :shown]
  defstruct [:id, :source, :shown, kind: :raster, type: nil, gzip?: false, zooms: 0..@max_zoom]

  @typedoc "`type`, `gzip?`: of all files of a folder."
  @type t :: %__MODULE__{
          id: String.t(),
          source: {:server, url :: String.t(), Secret.t() | nil} | {:archive | :folder, Path.t(), String.t()},
          shown: map(),
          kind: :raster | :vector,
          type: String.t() | nil,
          gzip?: boolean(),
          zooms: Range.t()
        }

  @doc """
  OpenStreetMap's own server. Its terms: attribution, a User-Agent of our own, keep for a week, two at a time, nothing
  in bulk.
  """
  @spec openstreetmap(url :: String.t() | nil) :: t()
  def openstreetmap(url) do
    server(
      %{
        id: "osm",
        name: "OpenStreetMap",
        attribution: "© OpenStreetMap contributors",
        url: url || "https://tile.openstreetmap.org/{z}/{x}/{y}.png",
        kind: :raster,
        min_zoom: 0,
        max_zoom: 19
      },
      nil
    )
  end

  @doc "A layer of the configuration; the error says what is wrong with its file."
  @spec new(map()) :: {:ok, t()} | {:error, String.t()}
  def new(%{url: url} = given) when url != nil do
    with {:ok, key} <- key(given[:key_file]), do: {:ok, server(given, key)}
  end

  def new(%{file: path} = given),
    do: if(File.dir?(path), do: folder(path, given), else: file(path, given))

  defp server(given, key) do
    zooms = given.min_zoom..given.max_zoom

    %__MODULE__{
      id: given.id,
      source: {:server, given.url, key},
      kind: given.kind,
      zooms: zooms,
      shown:
        Map.merge(shown(given), %{
          type: given.kind,
          url: "/tiles/#{given.id}/{z}/{x}/{y}",
          minzoom: zooms.first,
          maxzoom: zooms.last
        })
    }
  end

  defp shown(given),
    do: %{id: given.id, name: given[:name] || given.id, attribution: given[:attribution]}

  defp key(nil), do: {:ok, nil}

  defp key(path) do
    with {:ok, text} <- PrivateFile.read(path) do
      case String.trim(text) do
        key when byte_size(key) in 1..@max_key -> {:ok, Secret.new(key)}
        _other -> {:error, "#{path}: expected a key of 1 to #{@max_key} bytes"}
      end
    else
      {:error, :enoent} -> {:error, "#{path}: there is no such file"}
      error -> error
    end
  end

  @doc "Where a tile of a server is. Only the worker that asks the server may see it, because of the key."
  @spec url(t(), {integer(), integer(), integer()}) :: String.t()
  def url(%{source: {:server, url, key}}, {z, x, y}) do
    values = %{
      "{z}" => "#{z}",
      "{x}" => "#{x}",
      "{y}" => "#{y}",
      "{key}" => URI.encode_www_form(Secret.reveal(key) || "")
    }

    String.replace(url, Map.keys(values), &Map.fetch!(values, &1))
  end

  @doc "Whether an area of a layer may be fetched beforehand. The rules of OpenStreetMap's own servers forbid it."
  @spec prepares?(t()) :: boolean()
  def prepares?(%{source: {:server, url, _key}}),
    do: not (URI.parse(url).host =~ ~r/(^|\.)openstreetmap\.org$/i)

  def prepares?(_file), do: false

  @doc "Whether a tile can be in a layer."
  @spec holds?(t(), {integer(), integer(), integer()}) :: boolean()
  def holds?(%{zooms: zooms}, {z, x, y}), do: z in zooms and x in 0..(2 ** z - 1) and y in 0..(2 ** z - 1)

  # Everything else about it is found out by the pages that read it.
  defp file(path, given) do
    with {:ok, found} <- Pmtiles.look(path) do
      shown =
        Map.merge(shown(given), %{
          archive: "/tiles/#{given.id}",
          minzoom: found.min_zoom,
          maxzoom: found.max_zoom
        })

      {:ok, %__MODULE__{id: given.id, source: {:archive, path, found.kind}, shown: shown}}
    end
  end

  defp folder(path, given) do
    zooms = for name <- list(path), {z, ""} when z in 0..@max_zoom <- [Integer.parse(name)], do: z

    with [_ | _] <- zooms,
         first = Path.join(path, Integer.to_string(Enum.max(zooms))),
         [column | _] <- list(first),
         [tile | _] <- list(Path.join(first, column)),
         "." <> ending <- Path.extname(tile),
         %{^ending => {kind, type}} <- @formats do
      {low, high} = Enum.min_max(zooms)

      gzip? =
        kind == "vector" and
          match?({:ok, <<31, 139, _::binary>>}, File.read(Path.join([first, column, tile])))

      shown = %{type: kind, url: "/tiles/#{given.id}/{z}/{x}/{y}", minzoom: low, maxzoom: high}

      {:ok,
       %__MODULE__{
         id: given.id,
         source: {:folder, path, ending},
         type: type,
         gzip?: gzip?,
         zooms: low..high,
         shown: Map.merge(shown(given), shown)
       }}
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
end
