defmodule Aerie.Console.Map.Tiles.Fetcher.Worker do
  @moduledoc "Has one connection to a tile server, and asks for one tile after the other."
  use GenServer

  alias Aerie.Console.Map.Tiles.Fetcher.{Answer, Connection}
  alias Aerie.Console.Map.Tiles.{Cache, Layer}

  @typedoc "A tile of a layer, what is held of it, and its file."
  @type work :: %{
          layer: Layer.t(),
          tile: {integer(), integer(), integer()},
          held: Cache.entry() | nil,
          path: Path.t()
        }

  @doc "Options: `:owner`, which gets `{:fetched, worker, key, answer}`; `:connection`, options of `Connection.get/4`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options), do: GenServer.start_link(__MODULE__, options)

  @doc "Asks for a tile."
  @spec fetch(pid(), key :: term(), work()) :: :ok
  def fetch(worker, key, work), do: GenServer.cast(worker, {:fetch, key, work})

  @impl GenServer
  def init(options), do: {:ok, %{owner: options[:owner], options: options[:connection] || [], conn: nil}}

  @impl GenServer
  def handle_cast({:fetch, key, work}, state) do
    {answer, conn} = get(state, work)
    now = System.os_time(:second)
    answer = Answer.read(answer, work.layer.kind, work.held, now)
    # A full disk keeps nobody from seeing the tile.
    _ = with {:ok, entry} <- answer, do: Cache.write(work.path, entry)
    send(state.owner, {:fetched, self(), key, answer})
    {:noreply, %{state | conn: conn}}
  end

  defp get(state, %{layer: layer, tile: tile, held: held}) do
    accepted = if layer.kind == :vector, do: "gzip", else: "identity"
    known = if held && held.etag, do: [{"if-none-match", held.etag}], else: []
    headers = [{"user-agent", agent()}, {"accept", "*/*"}, {"accept-encoding", accepted} | known]
    Connection.get(state.conn, Layer.url(layer, tile), headers, state.options)
  rescue
    # What no server should be able to cause; its message may have the address, and so the key.
    _error -> {{:error, "its answer cannot be read"}, nil}
  end

  # The rules of public servers ask for a name that says which program this is.
  defp agent,
    do: "Aerie/#{Application.spec(:console, :vsn)} (gateway for MAVLink vehicles; keeps tiles on its disk)"
end
