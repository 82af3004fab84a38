defmodule Aerie.Console.Map.Tiles.Fetcher do
  @moduledoc """
  Fetches tiles from servers for all pages, as `Aerie.Console.Map.Tiles.Fetcher.Queue` decides, and keeps them on the
  disk within a limit.
  """
  use GenServer

  require Logger

  alias Aerie.Base.Names
  alias Aerie.Console.Map.Tiles.{Cache, Layer}
  alias Aerie.Console.Map.Tiles.Fetcher.{Queue, Worker}

  @wait_ms 20_000
  @idle_ms 20_000
  # Bytes that come before the disk is looked at again.
  @sweep_after 20_000_000

  @doc "Options: `:gateway`, `:dir`, `:most` (bytes on the disk); for tests `:connection` (`Connection.get/4`)."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :console_tile_fetcher))

  @doc """
  A tile of a server's layer: from the disk while it is new enough, else from the server, and else from the disk all
  the same.
  """
  @spec tile(Names.gateway(), Path.t(), Layer.t(), {integer(), integer(), integer()}) ::
          {:ok, Cache.entry()} | {:error, String.t()}
  def tile(gateway, dir, layer, tile) do
    now = System.os_time(:second)
    path = Cache.path(dir, layer, tile)

    case Cache.read(path, now) do
      %{until: until} = held when now < until ->
        {:ok, held}

      held ->
        with {:error, words} <- ask(gateway, %{layer: layer, tile: tile, held: held, path: path}),
             do: if(held, do: {:ok, held}, else: {:error, words})
    end
  end

  defp ask(gateway, work) do
    deadline = System.monotonic_time(:millisecond) + @wait_ms
    GenServer.call(Names.via(gateway, :console_tile_fetcher), {:ask, work, deadline}, @wait_ms)
  catch
    :exit, {:timeout, _call} -> {:error, "the server of this layer does not answer in time"}
    :exit, _gone -> {:error, "tiles cannot be fetched just now"}
  end

  @doc "Servers by `server/1` with their counts, and what layers have on the disk (nil: not counted yet)."
  @spec status(Names.gateway()) :: %{servers: %{String.t() => Queue.server()}, held: Cache.held() | nil}
  def status(gateway) do
    GenServer.call(Names.via(gateway, :console_tile_fetcher), :status)
  catch
    :exit, _gone -> %{servers: %{}, held: nil}
  end

  @doc "Removes what is kept of a layer. The caller does the work; this process forgets its count."
  @spec clear(Names.gateway(), Path.t(), Layer.t()) :: :ok | {:error, String.t()}
  def clear(gateway, dir, layer) do
    with {:ok, _removed} <- File.rm_rf(Path.join(dir, Cache.folder(layer))) do
      GenServer.cast(Names.via(gateway, :console_tile_fetcher), {:cleared, Cache.folder(layer)})
    else
      {:error, reason, path} -> {:error, "#{path}: #{:file.format_error(reason)}"}
    end
  end

  @doc "The server of a layer, as `status/1` names it."
  @spec server(Layer.t()) :: String.t()
  def server(layer) do
    %URI{host: host, port: port, scheme: scheme} = layer |> Layer.url({0, 0, 0}) |> URI.parse()
    if URI.default_port(scheme) == port, do: "#{host}", else: "#{host}:#{port}"
  end

  @impl GenServer
  def init(options) do
    Process.set_label({:console_tile_fetcher, options[:gateway]})

    state = %{
      queue: %Queue{},
      idle: [],
      dir: options[:dir],
      most: options[:most],
      connection: options[:connection],
      held: nil,
      new: 0,
      sweeping: nil
    }

    {:ok, sweep(state)}
  end

  @impl GenServer
  def handle_call({:ask, work, deadline}, from, state) do
    {:noreply, step(state, {:ask, work.path, server(work.layer), from, work, deadline})}
  end

  def handle_call(:status, _from, state),
    do: {:reply, %{servers: state.queue.servers, held: state.held}, state}

  # What is being counted just now has it still.
  @impl GenServer
  def handle_cast({:cleared, folder}, state),
    do: {:noreply, %{state | held: state.held && Map.delete(state.held, folder)}}

  @impl GenServer
  def handle_info({:fetched, worker, key, answer}, state) do
    %{server: name, work: work} = state.queue.jobs[key]
    timer = Process.send_after(self(), {:idle, worker}, @idle_ms)
    state = step(%{state | idle: [{name, worker, timer} | state.idle]}, {:done, key, answer})

    state =
      with {:ok, %{body: body}} <- answer, do: count(state, work, byte_size(body)), else: (_error -> state)

    {:noreply, if(state.new > @sweep_after, do: sweep(state), else: state)}
  end

  def handle_info({:idle, worker}, state) do
    {ended, idle} = Enum.split_with(state.idle, &(elem(&1, 1) == worker))
    for {_name, worker, _timer} <- ended, do: GenServer.stop(worker)
    {:noreply, %{state | idle: idle}}
  end

  def handle_info({task, held}, %{sweeping: task} = state) do
    Process.demonitor(task, [:flush])
    {:noreply, %{state | held: held, sweeping: nil}}
  end

  # One that was renewed is counted already.
  defp count(state, %{held: nil, layer: layer}, size),
    do: %{state | new: state.new + size, held: state.held && Cache.add(state.held, Cache.folder(layer), size)}

  defp count(state, _renewed, size), do: %{state | new: state.new + size}

  defp step(state, event) do
    {queue, actions} = Queue.handle(state.queue, event, System.monotonic_time(:millisecond))
    Enum.reduce(actions, %{state | queue: queue}, &act/2)
  end

  defp act({:reply, from, result}, state) do
    GenServer.reply(from, result)
    state
  end

  defp act({:start, key, name, work}, state) do
    case List.keytake(state.idle, name, 0) do
      {{_name, worker, timer}, idle} ->
        _ = Process.cancel_timer(timer)
        Worker.fetch(worker, key, work)
        %{state | idle: idle}

      nil ->
        {:ok, worker} = Worker.start_link(owner: self(), connection: state.connection)
        Worker.fetch(worker, key, work)
        state
    end
  end

  defp act({:failing, name, words}, state) do
    Logger.warning("map tiles of #{name}: #{words}. Tiles on the disk are shown, and it is asked again later")
    state
  end

  defp act({:working, name}, state) do
    Logger.info("map tiles of #{name} come again")
    state
  end

  # Looking at tens of thousands of files takes a second, so another process does it.
  defp sweep(%{sweeping: nil} = state) do
    task = Task.async(fn -> Cache.sweep(state.dir, state.most) end)
    %{state | sweeping: task.ref, new: 0}
  end

  defp sweep(state), do: state
end
