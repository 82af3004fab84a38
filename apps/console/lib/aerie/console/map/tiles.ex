defmodule Aerie.Console.Map.Tiles do
  @moduledoc """
  What the map of all pages stands on: the layers of `console.map.layers`, and OpenStreetMap once an admin has said
  yes. Pages ask only the gateway (`Aerie.Console.Map.Tiles.Handler`), which fetches tiles of servers (`Fetcher`) and
  keeps them. Layers that cannot be used are named in the log; the map does without them.

  The answer about OpenStreetMap and the areas that were prepared are in `map.json` of `console.map.dir`, and what an
  admin does to them in the audit log. A change of layers is the notice `:console_map` (`Aerie.Base.PubSub`).
  """
  use GenServer

  require Logger

  alias Aerie.Access.{Changes, PrivateFile}
  alias Aerie.Base.{Names, PubSub}
  alias Aerie.Console.Map.Tiles.{Area, Cache, Fetcher, Layer, Upload}

  @role :console_tiles

  @typedoc "`type`, `gzip?`: of the bytes."
  @type tile :: %{body: binary(), type: String.t(), gzip?: boolean()}

  @doc "Options: `:gateway`, `:settings`: `console.map`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], @role))

  @doc """
  The layers as pages learn of them, the answer about OpenStreetMap (nil: nobody has given one), whether the
  configuration gave it, and whether a map without any layer should ask for it.
  """
  @spec description(Names.gateway()) :: %{
          layers: [map()],
          openstreetmap: boolean() | nil,
          fixed: boolean(),
          ask: boolean()
        }
  def description(gateway) do
    case Names.value(gateway, @role) do
      %{layers: layers, openstreetmap: answer, fixed?: fixed?, areas: areas} ->
        ask? = answer == nil and layers == []

        %{
          layers: Enum.map(layers, &shown(&1, areas)),
          openstreetmap: answer,
          fixed: fixed?,
          ask: ask?
        }

      nil ->
        %{layers: [], openstreetmap: nil, fixed: true, ask: false}
    end
  end

  defp shown(layer, areas) do
    boxes = for %{layer: id, box: box, zoom: zoom} <- areas, id == layer.id, do: %{box: box, zoom: zoom}
    Map.merge(layer.shown, %{prepares: Layer.prepares?(layer), areas: boxes})
  end

  @doc "A tile of a folder or a server; nil if the layer has none there, or if there is no such layer."
  @spec tile(Names.gateway(), id :: String.t(), {integer(), integer(), integer()}) ::
          {:ok, tile()} | nil | {:error, String.t()}
  def tile(gateway, id, place) do
    with %{by_id: %{^id => layer}} = state <- Names.value(gateway, @role),
         true <- Layer.holds?(layer, place) do
      read(gateway, state, layer, place)
    else
      _none -> nil
    end
  end

  defp read(_gateway, _state, %{source: {:folder, path, ending}} = layer, {z, x, y}) do
    case File.read(Path.join([path, "#{z}", "#{x}", "#{y}.#{ending}"])) do
      {:ok, <<_, _::binary>> = body} -> {:ok, %{body: body, type: layer.type, gzip?: layer.gzip?}}
      _none -> nil
    end
  end

  defp read(gateway, state, %{source: {:server, _url, _key}} = layer, place) do
    case Fetcher.tile(gateway, cache(state.dir), layer, place) do
      {:ok, %{body: ""}} -> nil
      {:ok, entry} -> {:ok, entry}
      error -> error
    end
  end

  defp read(_gateway, _state, _archive, _place), do: nil

  @doc "The folder of fetched tiles."
  @spec cache(Path.t()) :: Path.t()
  def cache(dir), do: Path.join(dir, "cache")

  @doc "The PMTiles file of a layer, or nil."
  @spec archive(Names.gateway(), id :: String.t()) :: Path.t() | nil
  def archive(gateway, id) do
    case Names.value(gateway, @role) do
      %{by_id: %{^id => %{source: {:archive, path, _kind}}}} -> path
      _none -> nil
    end
  end

  @typedoc """
  A layer for an admin: `from` is a server, or `"file"` or `"folder"`. A server also has what is kept of it (nil: not
  counted yet), and its counts; `failing`: why, and for how many seconds it is left alone.
  """
  @type overview :: %{
          id: String.t(),
          name: String.t(),
          from: String.t(),
          server?: boolean(),
          held: {tiles :: non_neg_integer(), bytes :: non_neg_integer()} | nil,
          fetched: non_neg_integer(),
          errors: non_neg_integer(),
          failing: {String.t(), seconds :: non_neg_integer()} | nil
        }

  @doc "All layers, for admins."
  @spec overview(Names.gateway()) :: [overview()]
  def overview(gateway) do
    now = System.monotonic_time(:millisecond)
    %{servers: servers, held: held} = Fetcher.status(gateway)
    layers = with(%{layers: layers} <- Names.value(gateway, @role), do: layers) || []

    for %{source: source, shown: shown} = layer <- layers do
      base = %{id: layer.id, name: shown.name, server?: false, held: nil, fetched: 0, errors: 0, failing: nil}

      with {:server, _url, _key} <- source do
        counts = servers[Fetcher.server(layer)]
        until = counts && counts.until
        wait = until && until > now && {counts.words, div(until - now, 1_000) + 1}
        kept = held && Map.get(held, Cache.folder(layer), {0, 0})
        more = %{from: Fetcher.server(layer), server?: true, held: kept, failing: wait || nil}
        base |> Map.merge(more) |> Map.merge(Map.take(counts || %{}, [:fetched, :errors]))
      else
        {kind, _path, _more} -> Map.put(base, :from, if(kind == :archive, do: "file", else: "folder"))
      end
    end
  end

  @doc "Removes what is kept of a server's layer."
  @spec clear(Names.gateway(), id :: String.t(), Changes.by()) :: :ok | {:error, String.t()}
  def clear(gateway, id, by) do
    with %{dir: dir, by_id: %{^id => %{source: {:server, _url, _key}} = layer}} <- Names.value(gateway, @role),
         :ok <- Fetcher.clear(gateway, cache(dir), layer),
         :ok <- change(gateway, {:areas, &(&1.layer == id)}) do
      Changes.note(gateway, by, "change", %{"action" => "change_map", "cleared" => id})
    else
      {:error, words} -> {:error, words}
      _none -> {:error, "nothing is kept of #{id}"}
    end
  end

  # A tile has so many bytes, while fewer than so many are kept.
  @usual_bytes 20_000
  @enough 50

  @doc """
  What it takes to fetch the tiles of a box down to a zoom beforehand: the number of tiles, about how many bytes, and
  why it cannot be done.
  """
  @spec area(Names.gateway(), id :: String.t(), Area.Plan.box(), zoom :: non_neg_integer()) ::
          {:ok, Layer.t(), Area.Plan.t(), bytes :: pos_integer()} | {:error, String.t()}
  def area(gateway, id, box, zoom) do
    with %{most: most, by_id: %{^id => layer}} <- Names.value(gateway, @role),
         {:may, true} <- {:may, Layer.prepares?(layer)},
         {:ok, plan} <- Area.Plan.new(box, layer.zooms.first..min(zoom, layer.zooms.last)//1, most) do
      bytes = plan.total * tile_bytes(gateway, layer)

      words =
        "about #{div(bytes, 1_000_000)} MB; the gateway keeps #{div(most, 1_000_000)} (console.map.cache_mb)"

      if bytes <= most, do: {:ok, layer, plan, bytes}, else: {:error, words}
    else
      {:error, words} -> {:error, words}
      _none -> {:error, "areas of this layer cannot be prepared"}
    end
  end

  defp tile_bytes(gateway, layer) do
    case Fetcher.status(gateway).held[Cache.folder(layer)] do
      {tiles, bytes} when tiles >= @enough -> div(bytes, tiles) + 1
      _few -> @usual_bytes
    end
  end

  @doc "Begins to fetch an area (`area/4`)."
  @spec prepare(Names.gateway(), Layer.t(), Area.Plan.t(), Changes.by()) :: :ok | {:error, String.t()}
  def prepare(gateway, layer, plan, by) do
    with :ok <- Area.begin(gateway, layer, plan) do
      Changes.note(gateway, by, "change", %{
        "action" => "change_map",
        "prepared" => layer.id,
        "tiles" => plan.total
      })
    end
  end

  @doc "The areas that were prepared; some of their tiles may have gone since, when room was needed."
  @spec areas(Names.gateway()) :: [Area.Prepared.t()]
  def areas(gateway), do: Names.read(gateway, @role, [], & &1.areas)

  @doc "All tiles of an area have come."
  @spec prepared(Names.gateway(), Layer.t(), Area.Plan.t()) :: :ok
  def prepared(gateway, layer, plan),
    do: GenServer.cast(Names.via(gateway, @role), {:prepared, layer.id, plan})

  @doc "Takes an area off the list. Its tiles stay until room is needed."
  @spec forget(Names.gateway(), at :: integer(), Changes.by()) :: :ok | {:error, String.t()}
  def forget(gateway, at, by) do
    with :ok <- change(gateway, {:areas, &(&1.at == at)}),
         do: Changes.note(gateway, by, "change", %{"action" => "change_map", "forgot_area" => at})
  end

  @doc "An admin's answer: whether OpenStreetMap may be asked for tiles."
  @spec openstreetmap(Names.gateway(), boolean(), Changes.by()) :: :ok | {:error, String.t()}
  def openstreetmap(gateway, yes?, by), do: change(gateway, {:openstreetmap, yes?, by})

  @doc "The folder of uploaded files, and how many bytes one may have; nil if the map is not there just now."
  @spec files(Names.gateway()) :: {Path.t(), pos_integer()} | nil
  def files(gateway),
    do: with(%{dir: dir, upload: most} <- Names.value(gateway, @role), do: {Path.join(dir, "files"), most})

  @doc "A file was uploaded: it becomes a layer."
  @spec uploaded(Names.gateway(), name :: String.t(), Changes.by()) :: :ok | {:error, String.t()}
  def uploaded(gateway, name, by), do: change(gateway, {:uploaded, name, by})

  @doc "Removes an uploaded file."
  @spec remove(Names.gateway(), id :: String.t(), Changes.by()) :: :ok | {:error, String.t()}
  def remove(gateway, id, by), do: change(gateway, {:remove, id, by})

  defp change(gateway, change) do
    GenServer.call(Names.via(gateway, @role), change)
  catch
    :exit, _gone -> {:error, "the map cannot be changed just now; try again"}
  end

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({@role, gateway})
    settings = options[:settings]

    state = %{
      gateway: gateway,
      settings: settings,
      # Tests put another address there.
      osm: nil,
      own: own(settings.layers),
      answer: nil,
      areas: []
    }

    {:ok, state |> remembered() |> publish()}
  end

  defp remembered(state) do
    read = fn path ->
      with {:ok, text} <- PrivateFile.read(path),
           {:ok, %{"openstreetmap" => answer} = kept} when answer in [true, false, nil] <- JSON.decode(text),
           {:ok, areas} <- Area.Prepared.read(kept["areas"]) do
        {:ok, {answer, areas}}
      else
        {:error, :enoent} -> {:ok, {nil, []}}
        {:error, words} when is_binary(words) -> {:error, words}
        _damaged -> {:error, "expected JSON with openstreetmap and areas"}
      end
    end

    case PrivateFile.open(
           state.gateway,
           file(state),
           read,
           "admins are asked about OpenStreetMap again",
           {nil, []}
         ) do
      {:ok, {answer, areas}} -> %{state | answer: answer, areas: areas}
      {:error, words} -> unusable(state, words)
    end
  end

  defp unusable(state, words) do
    Logger.warning("console.map: #{words}; OpenStreetMap is off")
    %{state | answer: false}
  end

  defp file(state), do: Path.join(state.settings.dir, "map.json")

  defp own(layers) do
    for layer <- layers, {:ok, found} <- [opened(layer)], do: found
  end

  defp opened(layer) do
    with {:error, reason} <- Layer.new(layer) do
      Logger.warning(
        "console.map.layers, #{layer.id}: #{layer[:file]}#{if layer[:file], do: ": "}#{reason}; the map does without it"
      )

      :unusable
    end
  end

  # A file that somebody has damaged since is left out.
  defp files(dir, :all) do
    dir = Path.join(dir, "files")

    for name <- Upload.names(dir),
        {:ok, layer} <- [
          Layer.new(%{id: "file-" <> name, name: name, url: nil, file: Upload.path(dir, name)})
        ],
        do: put_in(layer.shown[:uploaded], true)
  end

  defp publish(state) do
    # What the configuration says stands above the answer.
    said = state.settings.openstreetmap
    answer = if is_boolean(said), do: said, else: state.answer
    osm = if answer, do: [Layer.openstreetmap(state.osm)], else: []
    # A name of the configuration comes first.
    layers = Enum.uniq_by(state.own ++ files(state.settings.dir, :all) ++ osm, & &1.id)

    Names.put_value(state.gateway, @role, %{
      layers: layers,
      by_id: Map.new(layers, &{&1.id, &1}),
      areas: state.areas,
      openstreetmap: answer,
      fixed?: is_boolean(said),
      dir: state.settings.dir,
      upload: state.settings.upload_mb * 1_000_000,
      most: state.settings.cache_mb * 900_000
    })

    PubSub.publish(state.gateway, {:notice, :console_map}, nil)
    state
  end

  @impl GenServer
  def handle_call({:openstreetmap, _yes?, _by}, _from, %{settings: %{openstreetmap: said}} = state)
      when is_boolean(said),
      do: {:reply, {:error, "console.map.openstreetmap in the configuration says it: change it there"}, state}

  def handle_call({:openstreetmap, yes?, by}, _from, state) do
    with {:ok, state} <- keep(%{state | answer: yes?}) do
      Changes.note(state.gateway, by, "change", %{"action" => "change_map", "openstreetmap" => yes?})
      {:reply, :ok, state}
    else
      error -> {:reply, error, state}
    end
  end

  # Those that are not wanted any more.
  def handle_call({:areas, gone?}, _from, state) do
    case Enum.reject(state.areas, gone?) do
      areas when areas == state.areas ->
        {:reply, :ok, state}

      areas ->
        with {:ok, state} <- keep(%{state | areas: areas}),
             do: {:reply, :ok, state},
             else: (error -> {:reply, error, state})
    end
  end

  def handle_call({:uploaded, name, by}, _from, state) do
    Changes.note(state.gateway, by, "change", %{"action" => "change_map", "uploaded" => name})
    {:reply, :ok, publish(state)}
  end

  def handle_call({:remove, "file-" <> name = id, by}, _from, state) do
    with true <- Upload.name?(name),
         :ok <- File.rm(Upload.path(Path.join(state.settings.dir, "files"), name)) do
      Changes.note(state.gateway, by, "change", %{"action" => "change_map", "removed" => name})
      {:reply, :ok, publish(state)}
    else
      {:error, reason} -> {:reply, {:error, "#{id}: #{:file.format_error(reason)}"}, state}
      false -> {:reply, {:error, "there is no such file"}, state}
    end
  end

  def handle_call({:remove, _id, _by}, _from, state),
    do: {:reply, {:error, "only uploaded files can be removed here"}, state}

  @impl GenServer
  def handle_cast({:prepared, id, %{box: box, zoom: zoom, total: tiles}}, state) do
    now = System.os_time(:microsecond)
    area = %{at: now, layer: id, box: [box.west, box.south, box.east, box.north], zoom: zoom, tiles: tiles}

    case keep(%{state | areas: Area.Prepared.add(state.areas, area)}) do
      {:ok, state} ->
        {:noreply, state}

      {:error, words} ->
        Logger.warning("console.map: the area that was prepared is not listed: #{words}")
        {:noreply, state}
    end
  end

  defp keep(state) do
    content = JSON.encode!(%{openstreetmap: state.answer, areas: state.areas})
    with :ok <- PrivateFile.write(file(state), content), do: {:ok, publish(state)}
  end
end
