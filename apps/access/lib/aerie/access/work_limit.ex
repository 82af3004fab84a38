defmodule Aerie.Access.WorkLimit do
  @moduledoc """
  Work of the console and of `/api` that costs more than a page: hashing passwords, reading files that somebody sends, and recordings and logs of
  the gateway. It is done by processes of low priority, a few at once, so that telemetry goes first. Requests beyond
  that number, or too frequent ones, are refused.

  | kind | at once | of one user or key |
  |---|---|---|
  | `:password`, looking at one or making one | a core of two, half of the cores of more | 5, and one in 12 s; signing in: `Aerie.Access.Limiter` |
  | `:users`, passwords that an admin gives | with `:password` | 20, and one in 3 s |
  | `:parse`, plans and parameter files | half of the cores | 20, and two a second |
  | `:read`, recordings, the audit log | one | 5, and one in 2 s |
  | `:event`, what pages ask for | | 400, and 40 a second: `spend/3` |

  A user's limits are those of all the user's sessions and pages together.
  """
  use GenServer

  alias Aerie.Base.Names
  alias Aerie.Base.Timing.TokenBucket
  alias Aerie.Access.WorkLimit.Places

  @half max(div(System.schedulers_online(), 2), 1)
  # Milliseconds between two, how many at first, and the places that it shares.
  @kinds %{
    password: {12_000, 5, :password},
    users: {3_000, 20, :password},
    parse: {500, 20, :parse},
    read: {2_000, 5, :read},
    event: {25, 400, nil}
  }
  @most_buckets 4_096

  @type kind :: :password | :users | :parse | :read
  @typedoc "A user or key by name, or the place that an attempt to sign in comes from, which is counted elsewhere."
  @type asker :: {:name, String.t()} | {:place, term(), known? :: boolean()}
  @type refusal :: {:busy, seconds :: pos_integer()}

  @doc "Options: `:gateway`; for tests `:now`, a function that returns monotonic milliseconds."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :costly))

  @doc "Does something in a place of its kind and gives its result; `{:busy, seconds}` if it was not begun, and when to ask again."
  @spec run(Names.gateway(), kind(), asker(), (-> result)) :: {:ok, result} | refusal() when result: term()
  def run(gateway, kind, asker, work) do
    case GenServer.call(Names.via(gateway, :costly), {:run, kind, asker, work}, :infinity) do
      {:failed, reason} -> exit(reason)
      answer -> answer
    end
  catch
    # Nothing is done beyond the limits, so nothing without those who keep them.
    :exit, {:noproc, _call} -> {:busy, 1}
  end

  @doc "Takes so many of a user's events; false if there are none left. Asks no process."
  @spec spend(Names.gateway(), name :: String.t(), cost :: pos_integer()) :: boolean()
  def spend(gateway, name, cost) do
    Names.read(gateway, :costly, false, fn {table, now} ->
      Enum.reduce_while(1..cost, true, fn _n, _any ->
        if take(table, now.(), :event, name) == :ok, do: {:cont, true}, else: {:halt, false}
      end)
    end)
  end

  # Two at once may both take the last token.
  defp take(table, now, kind, name) do
    {interval, burst, _places} = @kinds[kind]
    full = :ets.lookup_element(table, {kind, name}, 2, nil)

    case TokenBucket.take(full, now, interval, burst) do
      {:ok, full} ->
        _ =
          if :ets.info(table, :size) >= @most_buckets,
            do: :ets.select_delete(table, [{{:_, :"$1"}, [{:"=<", :"$1", now}], [true]}])

        :ets.insert(table, {{kind, name}, full})
        :ok

      :none ->
        {:busy, max(div(interval + 999, 1_000), 1)}
    end
  end

  @impl GenServer
  def init(options) do
    Process.set_label(:costly)
    table = :ets.new(:costly, [:set, :public, read_concurrency: true, write_concurrency: true])
    now = Keyword.get(options, :now, fn -> System.monotonic_time(:millisecond) end)
    Names.put_value(options[:gateway], :costly, {table, now})

    {:ok,
     %{
       table: table,
       now: now,
       places: Places.new(%{password: @half, parse: @half, read: 1}),
       running: %{}
     }}
  end

  @impl GenServer
  def handle_call({:run, kind, asker, work}, from, state) do
    {_interval, _burst, place} = @kinds[kind]
    request = %{place: place, asker: asker, work: work, from: from}

    with {:run, places} <- Places.ask(state.places, place, who(asker), known?(asker), request),
         :ok <- afford(state, kind, asker) do
      {:noreply, start(%{state | places: places}, request)}
    else
      {:wait, places} ->
        case afford(state, kind, asker) do
          :ok -> {:noreply, %{state | places: places}}
          busy -> {:reply, busy, state}
        end

      :busy ->
        {:reply, {:busy, 2}, state}

      busy ->
        {:reply, busy, state}
    end
  end

  defp afford(_state, _kind, {:place, _place, _known?}), do: :ok
  defp afford(state, kind, {:name, name}), do: take(state.table, state.now.(), kind, name)

  defp known?({:place, _place, known?}), do: known?
  defp known?({:name, _name}), do: true

  defp who({:place, place, _known?}), do: {:place, place}
  defp who(name), do: name

  # A low process gives way to all others; the hash itself runs beside the schedulers, so there are few at once.
  defp start(state, request) do
    {_pid, monitor} =
      spawn_monitor(fn ->
        Process.flag(:priority, :low)
        Process.set_label({:costly, request.place})
        exit({:shutdown, {:done, request.work.()}})
      end)

    put_in(state.running[monitor], Map.delete(request, :work))
  end

  @impl GenServer
  def handle_info({:DOWN, monitor, :process, _pid, reason}, state) when is_map_key(state.running, monitor) do
    {%{place: place, asker: asker, from: from}, running} = Map.pop!(state.running, monitor)

    case reason do
      {:shutdown, {:done, result}} -> GenServer.reply(from, {:ok, result})
      failed -> GenServer.reply(from, {:failed, failed})
    end

    {next, places} = Places.done(state.places, place, who(asker))
    state = %{state | running: running, places: places}
    {:noreply, with({:ok, request} <- next, do: start(state, request), else: (:none -> state))}
  end

  def handle_info(_stray, state), do: {:noreply, state}

  # Closures have passwords in them.
  @impl GenServer
  def format_status(status), do: Map.merge(status, %{state: :hidden, message: :hidden})
end
