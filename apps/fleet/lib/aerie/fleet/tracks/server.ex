defmodule Aerie.Fleet.Tracks.Server do
  @moduledoc """
  Once a second looks at all vehicles in the store, and writes what `Aerie.Fleet.Tracks.Core` wants written. No other
  process waits for it or does anything for it. Where it cannot write, it says so and tries again each second; nothing
  else stops.
  """
  # Its end writes to the disk.
  use GenServer, shutdown: 10_000

  alias Aerie.Base.Files.FolderLock
  alias Aerie.Base.{Names, Store}
  alias Aerie.Fleet
  alias Aerie.Fleet.Tracks.{Core, Files, Metrics, Sample, Settings}

  require Logger

  @tick_ms 1_000
  # Long enough that a fault of each tick does not use up the restarts of the gateway.
  @first_ms 3_000

  @doc "Options: `:gateway`, `:settings`, and `:tick_ms`: `:never` for tests that send `:tick`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :tracks))

  @impl GenServer
  def init(options) do
    %Settings{} = settings = Keyword.fetch!(options, :settings)
    gateway = options[:gateway]
    Process.set_label({:tracks, gateway})

    if Settings.on?(settings) do
      Process.flag(:trap_exit, true)

      state = %{
        gateway: gateway,
        dir: Path.expand(settings.dir),
        limits: [max_bytes: settings.max_bytes, keep_ms: settings.keep_h * 3_600_000],
        timer?: options[:tick_ms] != :never,
        core: Core.new(),
        files: nil,
        problem: nil
      }

      {:ok, state, {:continue, :open}}
    else
      Metrics.status(gateway, :off)
      :ignore
    end
  end

  @impl GenServer
  def handle_continue(:open, state) do
    state = open(state)
    _ = if state.timer?, do: Process.send_after(self(), :tick, @first_ms)
    {:noreply, state}
  end

  @impl GenServer
  def handle_info(:tick, state) do
    # At full seconds, so that all vehicles have the same ones.
    _ =
      if state.timer?,
        do: Process.send_after(self(), :tick, @tick_ms - rem(System.os_time(:millisecond), @tick_ms))

    {:noreply, state |> open() |> tick(System.os_time(:microsecond))}
  end

  def handle_info(_other, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, %{files: files}), do: if(files, do: Files.close(files))

  defp open(%{files: nil} = state) do
    with :ok <- FolderLock.acquire(state.dir),
         {:ok, files, damaged} <- Files.open(state.gateway, state.dir, state.limits) do
      if damaged > 0,
        do:
          Logger.warning(
            "tracks: #{damaged} files in #{state.dir} are damaged; what follows the damage is not shown"
          )

      well(%{state | files: files})
    else
      {:error, reason} -> failed(state, reason)
    end
  end

  defp open(state), do: state

  defp tick(%{files: nil} = state, _now), do: state

  defp tick(state, now) do
    at = div(now, 1000)
    links = Store.links(state.gateway)
    samples = for vehicle <- Fleet.vehicles(state.gateway), do: {vehicle.id, Sample.of(vehicle, links, now)}
    state = if Files.full?(state.files, at), do: told(state, :not_written), else: state
    told(state, {:tick, at, samples})
  end

  defp told(state, event) do
    {core, actions} = Core.handle(state.core, event)
    Enum.reduce(actions, %{state | core: core}, &act/2)
  end

  defp act({:left_out, samples}, state) do
    Metrics.count(state.gateway, :lost, samples)
    state
  end

  defp act({:write, at, begins?, block, samples}, state) do
    case Files.write(state.files, at, begins?, block) do
      {:ok, files, early} ->
        Metrics.written(state.gateway, samples, IO.iodata_length(block), early)
        well(%{state | files: files})

      {:error, reason, files} ->
        Metrics.count(state.gateway, :lost, samples)
        failed(told(%{state | files: files}, :not_written), reason)
    end
  end

  defp well(state) do
    if state.problem, do: Logger.notice("tracks: #{state.dir} can be written again")
    Metrics.status(state.gateway, %{dir: state.dir, bytes: Files.bytes(state.files), problem: nil})
    %{state | problem: nil}
  end

  defp failed(state, reason) do
    text = if is_binary(reason), do: reason, else: "#{state.dir}: #{:file.format_error(reason)}"

    if text != state.problem do
      Logger.warning(
        "tracks: #{text}; where the vehicles are is not kept for the replay until that is mended"
      )

      Metrics.failing(state.gateway, text)
    end

    bytes = if state.files, do: Files.bytes(state.files), else: 0
    Metrics.status(state.gateway, %{dir: state.dir, bytes: bytes, problem: text})
    # A folder that somebody removed is made again.
    %{state | problem: text, files: if(reason != :enoent, do: state.files)}
  end
end
