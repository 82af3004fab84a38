defmodule Aerie.Console.Map.Tiles.Area do
  @moduledoc """
  Fetches the tiles of an area before somebody flies there without internet (`Area.Plan` decides), one area at a time,
  through `Aerie.Console.Map.Tiles.Fetcher`, so that it waits beside what pages ask for, and what is kept already is
  not asked for again.
  """
  use GenServer

  alias Aerie.Base.Names
  alias Aerie.Console.Map.Tiles
  alias Aerie.Console.Map.Tiles.Area.Plan
  alias Aerie.Console.Map.Tiles.{Fetcher, Layer}

  @role :console_map_area

  @type status :: %{
          layer: String.t(),
          total: non_neg_integer(),
          done: non_neg_integer(),
          bytes: non_neg_integer(),
          ended: nil | String.t()
        }

  @doc "Options: `:gateway`, `:dir` of kept tiles."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], @role))

  @doc "Begins; refused while another area is on its way."
  @spec begin(Names.gateway(), Layer.t(), Plan.t()) :: :ok | {:error, String.t()}
  def begin(gateway, layer, plan), do: call(gateway, {:begin, layer, plan})

  @doc "The present or last area; nil if there was none since the start."
  @spec status(Names.gateway()) :: status() | nil | {:error, String.t()}
  def status(gateway), do: call(gateway, :status)

  @doc "Ends it; what has come stays."
  @spec cancel(Names.gateway()) :: :ok | {:error, String.t()}
  def cancel(gateway), do: call(gateway, :cancel)

  defp call(gateway, what) do
    GenServer.call(Names.via(gateway, @role), what)
  catch
    :exit, _gone -> {:error, "no area can be prepared just now; try again"}
  end

  @impl GenServer
  def init(options) do
    Process.set_label({@role, options[:gateway]})
    {:ok, %{gateway: options[:gateway], dir: options[:dir], layer: nil, plan: nil, id: nil, tasks: %{}}}
  end

  @impl GenServer
  def handle_call({:begin, _layer, _plan}, _from, %{plan: %{ended: nil}} = state),
    do: {:reply, {:error, "another area is being prepared"}, state}

  # Answers to questions of the last one are not awaited any more.
  def handle_call({:begin, layer, plan}, _from, state),
    do: {:reply, :ok, step(%{state | layer: layer, plan: plan, id: make_ref(), tasks: %{}}, :begin)}

  def handle_call(:status, _from, %{plan: nil} = state), do: {:reply, nil, state}

  def handle_call(:status, _from, %{plan: plan, layer: layer} = state) do
    ended = if plan.ended == :done, do: "done", else: plan.ended
    {:reply, %{layer: layer.id, total: plan.total, done: plan.done, bytes: plan.bytes, ended: ended}, state}
  end

  def handle_call(:cancel, _from, %{plan: nil} = state), do: {:reply, :ok, state}
  def handle_call(:cancel, _from, state), do: {:reply, :ok, step(state, {:cancel, "cancelled"})}

  @impl GenServer
  def handle_info({task, result}, %{tasks: tasks} = state) when is_map_key(tasks, task) do
    Process.demonitor(task, [:flush])
    {number, tasks} = Map.pop!(tasks, task)
    result = with {:ok, %{body: body}} <- result, do: {:ok, byte_size(body)}
    {:noreply, step(%{state | tasks: tasks}, {:fetched, number, result})}
  end

  def handle_info({:again, id, number}, %{id: id} = state), do: {:noreply, step(state, {:again, number})}
  def handle_info(_of_the_last_one, state), do: {:noreply, state}

  defp step(state, event) do
    {plan, actions} = Plan.handle(state.plan, event)
    if {state.plan.ended, plan.ended} == {nil, :done}, do: Tiles.prepared(state.gateway, state.layer, plan)
    Enum.reduce(actions, %{state | plan: plan}, &act/2)
  end

  defp act({:fetch, number}, %{gateway: gateway, dir: dir, layer: layer} = state) do
    place = Plan.tile(state.plan, number)
    task = Task.async(fn -> Fetcher.tile(gateway, dir, layer, place) end)
    put_in(state.tasks[task.ref], number)
  end

  defp act({:wait, ms, number}, state) do
    Process.send_after(self(), {:again, state.id, number}, ms)
    state
  end
end
