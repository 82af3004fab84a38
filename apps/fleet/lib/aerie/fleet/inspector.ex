defmodule Aerie.Fleet.Inspector do
  @moduledoc """
  Every message that goes over the links to vehicles, live: which ones, how often, and the last one of each.

      :ok = Aerie.Fleet.Inspector.watch(:default)
      Aerie.Fleet.Inspector.rows(:default, system: 7)
      Aerie.Fleet.Inspector.last(:default, {"radio", :in, 7, 1, 30})

  It looks only while somebody watches (`watch/1`, until that process ends): without watchers the links pay nothing. It
  gets frames by the recorder's taps, so it never makes a link wait: what it cannot take at once is left out and counted
  (`skipped`). Nothing is decoded but what somebody asks for, in the process of the caller (`show/1`).

  What a link sends is seen as far as the recorder sees it (`recorder.sent`); without a recorder there is
  nothing to see. Passwords and keys (`MavCodec.Signing.Redact`) are never shown (S9).
  """
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.Policy.Roles
  alias Aerie.Fleet.Client.RawMessage
  alias Aerie.Fleet.Inspector.{Compose, Fields, Rows}
  alias MavRouter.Recorder.{Tables, Tap}
  alias MavCodec.Frame

  # The number of frames of one link that wait for this process.
  @queue 256 * 1024
  @every_ms 1_000
  @call_ms 30_000

  @typedoc "One row: a message of a component by a link, received (`:in`) or sent (`:out`)."
  @type key ::
          {link :: String.t(), :in | :out, system :: non_neg_integer, component :: 0..255,
           id :: non_neg_integer}

  @typedoc """
  `name` is that of the message, `\"#300\"` for an unknown one; `hz` the mean of the last seconds; `at` in unix
  microseconds, nil where the frame has no time.
  """
  @type row :: %{key: key, name: String.t(), count: pos_integer, hz: float, at: integer | nil}

  @doc "Options: `:gateway`; `:every_ms` between two measurements of the rates, for tests."
  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, options, name: Names.via(gateway, :inspector))
  end

  @doc "Looks for the calling process until it ends, or until `unwatch/1`."
  @spec watch(Names.gateway()) :: :ok | {:error, :not_running | :no_recorder}
  def watch(gateway) do
    GenServer.call(Names.via(gateway, :inspector), :watch, @call_ms)
  catch
    :exit, _gone -> {:error, :not_running}
  end

  @doc "Ends `watch/1`."
  @spec unwatch(Names.gateway()) :: :ok
  def unwatch(gateway) do
    GenServer.call(Names.via(gateway, :inspector), :unwatch, @call_ms)
  catch
    :exit, _gone -> :ok
  end

  @doc """
  The rows that are heard, of one link, direction, system, component or message id if these are given; in the order of
  their keys.
  """
  @spec rows(Names.gateway(), keyword) :: [row]
  def rows(gateway, filter \\ []),
    do: read(gateway, [], &Rows.list(&1, filter))

  @doc "The last frame of a row; nil when there is none."
  @spec last(Names.gateway(), key) :: Frame.t() | nil
  def last(gateway, key), do: read(gateway, nil, &Rows.frame(&1, key))

  @doc "A frame for people: its name, its fields (nil for an unknown message), and its bytes in hexadecimal."
  @spec show(Frame.t()) :: %{name: String.t(), fields: [Fields.field()] | nil, hex: String.t()}
  def show(frame), do: %{name: Fields.name(frame.id), fields: Fields.of(frame), hex: Fields.hex(frame.bytes)}

  @doc "The names of all messages, sorted."
  @spec message_names() :: [String.t()]
  defdelegate message_names, to: Compose, as: :names

  @doc "The fields of a message by its name; empty for an unknown one."
  @spec message_fields(String.t()) :: [map]
  defdelegate message_fields(name), to: Compose, as: :fields

  @doc "The message of a name and the texts of its fields, or what is wrong with each."
  @spec compose(String.t(), %{String.t() => String.t()}) ::
          {:ok, struct} | {:error, %{String.t() => String.t()}}
  defdelegate compose(name, texts), to: Compose, as: :message

  @doc "Sends a message in the name of somebody, like one of a client, and gives what was answered."
  @spec send(Names.gateway(), Roles.source(), struct(), network :: String.t() | :all) ::
          {:ok, RawMessage.result()} | {:error, String.t()}
  defdelegate send(gateway, source, message, network), to: RawMessage

  @doc "The last message of a row; an error when there is none, or it cannot be read."
  @spec message(Names.gateway(), key) :: {:ok, struct()} | {:error, term()}
  def message(gateway, key) do
    case last(gateway, key) do
      nil -> {:error, :absent}
      frame -> MavCodec.decode(frame)
    end
  end

  @doc """
  How many frames were left out since somebody began to watch: they came too fast, or there were too many different
  ones.
  """
  @spec skipped(Names.gateway()) :: non_neg_integer
  def skipped(gateway), do: read(gateway, 0, &Rows.skipped/1)

  defp read(gateway, absent, fun), do: Names.read(gateway, :inspector, absent, fun)

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:inspector, gateway})
    rows = Rows.new()
    Names.put_value(gateway, :inspector, rows)

    {:ok,
     %{
       gateway: gateway,
       every_ms: Keyword.get(options, :every_ms, @every_ms),
       rows: rows,
       watchers: %{},
       taps: %{},
       timer: nil
     }}
  end

  @impl GenServer
  def handle_call(:watch, {pid, _tag}, state) do
    cond do
      Tables.of(state.gateway) == nil -> {:reply, {:error, :no_recorder}, state}
      is_map_key(state.watchers, pid) -> {:reply, :ok, state}
      true -> {:reply, :ok, begin(put_in(state.watchers[pid], Process.monitor(pid)))}
    end
  end

  def handle_call(:unwatch, {pid, _tag}, state), do: {:reply, :ok, leave(state, pid)}

  @impl GenServer
  def handle_info({:record, {:link, link}, bytes, frames, n}, state) do
    # One that was on its way when the last watcher left has no tap any more.
    with {:ok, tap} <- Map.fetch(state.taps, link) do
      Rows.add(state.rows, link, if(n == :sent, do: :out, else: :in), frames)
      Tap.done(tap, bytes)
    end

    {:noreply, state}
  end

  def handle_info({:DOWN, _ref, :process, pid, _reason}, state), do: {:noreply, leave(state, pid)}

  def handle_info(:measure, %{watchers: watchers} = state) when watchers == %{},
    do: {:noreply, %{state | timer: nil}}

  def handle_info(:measure, state) do
    state = follow(state)
    dropped = state.taps |> Map.values() |> Enum.map(&Tap.dropped/1) |> Enum.sum()
    Rows.measure(state.rows, dropped, System.monotonic_time(:millisecond))
    {:noreply, schedule(state)}
  end

  def handle_info(_stray, state), do: {:noreply, state}

  defp begin(%{timer: nil} = state), do: state |> follow() |> schedule()
  defp begin(state), do: state

  defp schedule(state), do: %{state | timer: Process.send_after(self(), :measure, state.every_ms)}

  defp leave(state, pid) do
    {ref, watchers} = Map.pop(state.watchers, pid)
    _ = if ref, do: Process.demonitor(ref, [:flush])
    if watchers == %{}, do: finish(%{state | watchers: watchers}), else: %{state | watchers: watchers}
  end

  defp finish(state) do
    _ = if state.timer, do: Process.cancel_timer(state.timer)

    _ =
      with_tables(state.gateway, :ok, fn tables ->
        Enum.each(state.taps, fn {link, _tap} -> Tap.close(tables, {:link, link}) end)
      end)

    flush()
    Rows.clear(state.rows)
    %{state | taps: %{}, timer: nil}
  end

  defp flush do
    receive do
      {:record, _target, _bytes, _frames, _n} -> flush()
      :measure -> flush()
    after
      0 -> :ok
    end
  end

  # Links come and go; after a restart of the recorder its taps are new.
  defp follow(state) do
    taps =
      with_tables(state.gateway, %{}, fn tables ->
        links = for %{id: id} <- Store.links(state.gateway), do: id
        for {link, _tap} <- state.taps, link not in links, do: Tap.close(tables, {:link, link})
        Map.new(links, &{&1, tap(state.taps, tables, &1)})
      end)

    %{state | taps: taps}
  end

  defp with_tables(gateway, none, fun) do
    case Tables.of(gateway) do
      nil -> none
      tables -> fun.(tables)
    end
  rescue
    # The tables go with the recorder, which may be ending just now.
    ArgumentError -> none
  end

  defp tap(taps, tables, link) do
    case taps do
      %{^link => tap} -> if Tap.tapped?(tables, {:link, link}, self()), do: tap, else: open(tables, link)
      _new -> open(tables, link)
    end
  end

  defp open(tables, link), do: Tap.open(tables, {:link, link}, @queue)
end
