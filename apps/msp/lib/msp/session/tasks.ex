defmodule Msp.Session.Tasks do
  @moduledoc """
  What clients asked for that needs the flight controller: one request after the other, each by its turn.

  A task is a map with `kind` (the module that knows it) and `ask`, its next request: `{message, values}` or `{message, values, patience}`
  in us. Tasks that read hundreds of values are `bulk`: they take the turns that no poll needs, so that a vehicle is not silent meanwhile.
  """

  alias Msp.{Identity, Session}

  @most 16

  @type t :: %{
          :kind => module,
          :ask => {String.t(), map} | {String.t(), map, non_neg_integer},
          optional(atom) => term
        }
  @typedoc "The values of a reply, or what came in place of one."
  @type answer :: {:ok, map} | :refused | :timeout | {:unfit, why :: String.t()}

  @doc "The answer to its request: the session with the task's next request (`ask_next/3`), or with what comes of it (`done/2`)."
  @callback answer(Session.t(), t, answer, now :: integer) :: Session.t()

  @doc "Whether there is room for another one."
  @spec room?(Session.t()) :: boolean
  def room?(%{tasks: tasks}), do: length(tasks) < @most

  @doc "Adds a task at the end."
  @spec add(Session.t(), t) :: Session.t()
  def add(session, task) do
    serial = session.serial + 1
    %{session | serial: serial, tasks: session.tasks ++ [Map.put(task, :serial, serial)]}
  end

  @doc "Its next request, and changes of it."
  @spec ask_next(Session.t(), t, map) :: Session.t()
  def ask_next(session, %{serial: serial} = task, changes) do
    task = Map.merge(task, changes)
    %{session | tasks: Enum.map(session.tasks, &if(&1.serial == serial, do: task, else: &1))}
  end

  @doc "It is over."
  @spec done(Session.t(), t) :: Session.t()
  def done(session, %{serial: serial}),
    do: %{session | tasks: Enum.reject(session.tasks, &(&1.serial == serial))}

  @doc "The next request of a task: of the first one that is not bulk, or of the first bulk one; `:none`. One that cannot be sent is over."
  @spec next(Session.t(), :urgent | :bulk) ::
          {{:ask, t, MavCodec.Msp.Frame.t(), non_neg_integer} | :none, Session.t()}
  def next(session, kind) do
    case Enum.find(session.tasks, &(bulk?(&1) == (kind == :bulk))) do
      nil ->
        {:none, session}

      task ->
        {name, values, patience} = ask(task.ask)

        case MavCodec.Msp.request(Identity.target(session.identity), name, values) do
          {:ok, frame} -> {{:ask, task, frame, patience}, session}
          {:error, why} -> session |> task.kind.answer(task, {:unfit, why}, 0) |> next(kind)
        end
    end
  end

  defp bulk?(task), do: Map.get(task, :bulk, false)

  defp ask({name, values}), do: {name, values, 0}
  defp ask(whole), do: whole

  @doc "The answer to a task's request. One that was given up meanwhile gets none."
  @spec reply(Session.t(), t, answer, integer) :: Session.t()
  def reply(session, %{serial: serial}, answer, now) do
    case Enum.find(session.tasks, &(&1.serial == serial)) do
      nil -> session
      task -> task.kind.answer(session, task, answer, now)
    end
  end
end
