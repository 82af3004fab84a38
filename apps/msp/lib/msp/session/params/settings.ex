defmodule Msp.Session.Params.Settings do
  @moduledoc "One setting of iNav, by name: what it is comes with its value. To set it, the value is written, and read again."

  alias Msp.Params.Setting
  alias Msp.Session
  alias Msp.Session.Params.Answers
  alias Msp.Session.Tasks

  @doc "The first request."
  @spec first(String.t()) :: map
  def first(name), do: %{by: __MODULE__, ask: info(name), stage: :before}

  @doc "The request for a setting by its name or its number."
  @spec info(String.t() | non_neg_integer) :: {String.t(), map}
  def info(name), do: {"MSP2_COMMON_SETTING_INFO", %{name_or_index: Setting.request(name)}}

  @doc "The type by which clients get it."
  @spec told(Setting.t()) :: Answers.type()
  def told(setting), do: Answers.type(setting.type, setting.high)

  @doc "The answer to a request of the task."
  @spec answer(Session.t(), Tasks.task(), Tasks.answer()) :: Session.t()
  def answer(session, %{stage: :before} = task, {:ok, values}) do
    case {task.what, Setting.read(values)} do
      {:read, {:ok, setting}} -> Answers.report(session, task, setting.value, told(setting))
      {:set, {:ok, setting}} -> write(session, task, setting)
      _text -> Answers.refuse(session, task, :unknown, "it is text, which MAVLink's parameters cannot be")
    end
  end

  def answer(session, %{stage: :written} = task, {:ok, _acknowledged}),
    do: Tasks.ask_next(session, task, %{stage: :check, ask: info(task.name)})

  def answer(session, %{stage: :check} = task, {:ok, values}) do
    case Setting.read(values) do
      {:ok, setting} -> session |> Answers.changed() |> Answers.report(task, setting.value, told(setting))
      _unreadable -> Tasks.done(session, task)
    end
  end

  def answer(session, %{stage: :before} = task, :refused),
    do: Answers.refuse(session, task, :unknown, "this firmware does not have it")

  def answer(session, task, :refused),
    do: Answers.refuse(session, task, :denied, "the flight controller refused it")

  defp write(session, task, setting) do
    case Setting.write(setting, task.value) do
      {:ok, payload} ->
        Tasks.ask_next(session, task, %{
          stage: :written,
          ask: {"MSP2_COMMON_SET_SETTING", %{setting: payload}}
        })

      {:error, why} ->
        Answers.refuse(session, task, :out_of_range, why)
    end
  end
end
