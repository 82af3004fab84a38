defmodule Msp.Session.Tasks do
  @moduledoc """
  What clients asked for that needs the flight controller: one request after the other, each by its turn.

  A task is a map with `kind` (the module that knows it) and `ask`, its next request: `{message, values}` or `{message, values, patience}`
  in us. What is not for armed vehicles is sent only to one that said less than a second ago that it is disarmed; tasks
  with `armed: true` are for
  armed ones. Tasks that read hundreds of values are `bulk`: they take the turns that no poll needs, so that a vehicle
  is not silent meanwhile.
  """

  alias MavCodec.Msp.{Frame, Guard, Messages}
  alias Msp.{Identity, Polls, Session}
  alias Msp.Session.Tasks.Armed

  @most 16
  # How often a vehicle is asked whether it is armed before a task is refused.
  @most_looks 3

  defstruct list: [], serial: 0

  @typedoc "What waits, in its order; `serial`: the number of the last one."
  @type t :: %__MODULE__{list: [task], serial: non_neg_integer}
  @type task :: %{
          :kind => module,
          :ask => {String.t(), map} | {String.t(), map, non_neg_integer} | {Frame.t(), non_neg_integer},
          optional(atom) => term
        }
  @typedoc "The values of a reply, or what came in place of one."
  @type answer ::
          {:ok, map} | {:frame, Frame.t()} | :refused | :timeout | {:unfit | :denied, why :: String.t()}

  @doc "The answer to its request: the session with the task's next request (`ask_next/3`), or with what comes of it (`done/2`)."
  @callback answer(Session.t(), task, answer, now :: integer) :: Session.t()

  @doc "Whether there is room for another one of a client."
  @spec room?(Session.t()) :: boolean
  def room?(%{tasks: tasks}), do: Enum.count(tasks.list, &(class(&1) != :program)) < @most

  @doc "Whether there is one like this."
  @spec any?(Session.t(), (task -> boolean)) :: boolean
  def any?(%{tasks: tasks}, like? \\ fn _any -> true end), do: Enum.any?(tasks.list, like?)

  @doc "Adds a task at the end."
  @spec add(Session.t(), task) :: Session.t()
  def add(%{tasks: %{list: list, serial: last}} = session, task),
    do: %{session | tasks: %__MODULE__{list: list ++ [Map.put(task, :serial, last + 1)], serial: last + 1}}

  @doc "Changes those like this."
  @spec change(Session.t(), (task -> boolean), (task -> task)) :: Session.t()
  def change(%{tasks: tasks} = session, like?, fun),
    do: %{session | tasks: %{tasks | list: Enum.map(tasks.list, &if(like?.(&1), do: fun.(&1), else: &1))}}

  @doc "Gives up those like this."
  @spec drop(Session.t(), (task -> boolean)) :: Session.t()
  def drop(%{tasks: tasks} = session, like? \\ fn _any -> true end),
    do: %{session | tasks: %{tasks | list: Enum.reject(tasks.list, like?)}}

  @doc "Its next request, and changes of it."
  @spec ask_next(Session.t(), task, map) :: Session.t()
  def ask_next(session, %{serial: serial} = task, changes) do
    task = task |> Map.delete(:looks) |> Map.merge(changes)
    change(session, &(&1.serial == serial), fn _former -> task end)
  end

  @doc "It is over."
  @spec done(Session.t(), task) :: Session.t()
  def done(session, %{serial: serial}), do: drop(session, &(&1.serial == serial))

  @doc """
  The next request of a task: of the first command of a client (`:urgent`), of the first request of a program (`:program`), or of what takes long
  (`:bulk`); `:none`; `:look` if the vehicle is to be asked first whether it is armed. One that cannot be sent is over.
  """
  @spec next(Session.t(), :urgent | :program | :bulk) ::
          {{:ask, task, Frame.t(), non_neg_integer} | :look | :none, Session.t()}
  def next(session, kind) do
    case Enum.find(session.tasks.list, &(class(&1) == kind)) do
      nil ->
        {:none, session}

      task ->
        with {:ok, frame, patience} <- request(task.ask, Identity.target(session.identity)),
             :ok <- in_time(session, task, frame) do
          {{:ask, task, frame, patience}, session}
        else
          :look -> {:look, ask_next(session, task, %{looks: looks(task) + 1})}
          {:denied, why} -> session |> task.kind.answer(task, {:denied, why}, session.now) |> next(kind)
          {:error, why} -> session |> task.kind.answer(task, {:unfit, why}, session.now) |> next(kind)
        end
    end
  end

  # It may have been armed since it was asked for.
  defp in_time(_session, %{armed: true}, _frame), do: :ok

  defp in_time(session, task, frame) do
    {:ok, message} = Messages.fetch(session.identity.firmware, frame.id)

    cond do
      not Armed.only_disarmed?(message, frame) ->
        :ok

      Armed.refusal(session) == nil ->
        :ok

      Armed.state(session) == :unknown and looks(task) < @most_looks and Polls.status(session.polls) != nil ->
        :look

      true ->
        {:denied, Armed.refusal(session)}
    end
  end

  defp looks(task), do: Map.get(task, :looks, 0)

  defp class(%{bulk: true}), do: :bulk
  defp class(%{client: id}) when id != nil, do: :program
  defp class(_command), do: :urgent

  # A program's frame was checked when it came, maybe for another version.
  defp request({%Frame{} = frame, patience}, target),
    do: with({:ok, _message} <- Guard.check(frame, target), do: {:ok, frame, patience})

  defp request({name, values}, target), do: request({name, values, 0}, target)

  defp request({name, values, patience}, target),
    do: with({:ok, frame} <- MavCodec.Msp.request(target, name, values), do: {:ok, frame, patience})

  @doc "The answer to a task's request. One that was given up meanwhile gets none."
  @spec reply(Session.t(), task, answer, integer) :: Session.t()
  def reply(session, %{serial: serial}, answer, now) do
    case Enum.find(session.tasks.list, &(&1.serial == serial)) do
      nil -> session
      task -> task.kind.answer(session, task, answer, now)
    end
  end
end
