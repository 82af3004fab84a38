defmodule FleetWeb.Console.System.Sampler do
  @moduledoc """
  Measures what the system page shows, once for all viewers: at most every two seconds, and not at all while nobody asks. Only a
  measurement visits all processes.

  Between measurements it monitors the processes of the supervision tree, so that a process that died and was started again counts as
  a restart, with its reason, whether or not somebody was looking. It does not know processes that started after the last measurement, so it measures
  again shortly after a death, and every minute.
  """
  use GenServer

  alias Aerie.Base.Names
  alias FleetWeb.Console.System.{BusiestProcesses, Figures, Restarts, Tree}

  @fresh_ms 2_000
  @after_death_ms 500
  @idle_ms 60_000
  @call_ms 10_000

  @typedoc "`at` in unix microseconds; the rest as in these modules."
  @type sample :: %{at: integer(), facts: Figures.t(), tree: Tree.t() | nil, top: BusiestProcesses.t()}

  @doc "Options: `:gateway`; `:fresh_ms`, `:after_death_ms` for tests."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :console_system))

  @doc "The last sample, at most two seconds old, or nil if there is none."
  @spec sample(Names.gateway()) :: sample() | nil
  def sample(gateway) do
    GenServer.call(Names.via(gateway, :console_system), :sample, @call_ms)
  catch
    :exit, _absent_or_busy -> nil
  end

  @impl GenServer
  def init(options) do
    gateway = options[:gateway]
    Process.set_label({:console_system, gateway})
    send(self(), :look)

    {:ok,
     %{
       gateway: gateway,
       fresh_ms: Keyword.get(options, :fresh_ms, @fresh_ms),
       after_death_ms: Keyword.get(options, :after_death_ms, @after_death_ms),
       restarts: Restarts.new(),
       timer: nil,
       facts: nil,
       reductions: %{},
       sample: nil,
       begun: nil,
       measured: nil
     }}
  end

  @impl GenServer
  def handle_call(:sample, _from, state) do
    now = System.monotonic_time(:millisecond)
    fresh? = state.measured != nil and now - state.measured < state.fresh_ms
    state = if fresh?, do: state, else: measure(state)
    {:reply, state.sample, state}
  end

  @impl GenServer
  def handle_info({:DOWN, ref, :process, _pid, reason}, state) do
    restarts = Restarts.down(state.restarts, ref, reason, System.os_time(:microsecond))
    {:noreply, look_in(%{state | restarts: restarts}, state.after_death_ms)}
  end

  def handle_info(:look, state) do
    {_tree, state} = look(%{state | timer: nil})
    {:noreply, look_in(state, @idle_ms)}
  end

  def handle_info(_stray, state), do: {:noreply, state}

  defp look_in(%{timer: {timer, due}} = state, ms) do
    if due - System.monotonic_time(:millisecond) > ms do
      _ = Process.cancel_timer(timer)
      look_in(%{state | timer: nil}, ms)
    else
      state
    end
  end

  defp look_in(state, ms),
    do: %{state | timer: {Process.send_after(self(), :look, ms), System.monotonic_time(:millisecond) + ms}}

  defp look(state) do
    tree = Tree.of(state.gateway)
    restarts = Restarts.seen(state.restarts, Tree.processes(tree), System.os_time(:microsecond))
    {tree, %{state | restarts: restarts}}
  end

  defp measure(state) do
    now = System.monotonic_time(:millisecond)
    {tree, state} = look(state)
    {top, reductions} = BusiestProcesses.of(state.reductions, state.begun && now - state.begun)
    facts = Figures.of(state.gateway, state.facts)

    sample = %{
      at: System.os_time(:microsecond),
      facts: facts,
      tree: tree && Tree.decorate(tree, &Restarts.of(state.restarts, &1)),
      top: top
    }

    # Two seconds from its end: a caller during a long measurement gets this one, not another one.
    measured = System.monotonic_time(:millisecond)
    %{state | sample: sample, begun: now, measured: measured, facts: facts, reductions: reductions}
  end
end
