defmodule Msp.Session.Params.Lines do
  @moduledoc """
  One parameter of Betaflight from API 1.48 on, by name: what it is, then its value. To set it, a line is written that the firmware checks, and its value is
  read again. A build without a command line refuses the first question: then its block is used.
  """

  alias Msp.Params.Line
  alias Msp.Session
  alias Msp.Session.Params.{Answers, Blocks}
  alias Msp.Session.Tasks

  @most_text 8_192

  @doc "The first request; `param` is its row in the table, nil if it has none."
  @spec first(String.t(), MavCodec.Msp.Params.t() | nil) :: map
  def first(name, param),
    do: %{by: __MODULE__, param: param, ask: Line.info(name, 0), stage: :before, text: ""}

  @doc "The answer to a request of the task."
  @spec answer(Session.t(), Tasks.task(), Tasks.answer()) :: Session.t()
  def answer(session, %{stage: :before} = task, {:ok, reply}) do
    case described(task, reply) do
      {:more, changes} -> Tasks.ask_next(session, task, changes)
      {:ok, line} when task.what == :read -> ask_value(session, task, %{stage: :value, line: line})
      {:ok, line} -> write(session, task, line)
      :text -> Answers.refuse(session, task, :unknown, "it is text, which MAVLink's parameters cannot be")
      :error -> Answers.refuse(session, task, :unknown, "what the firmware says of it cannot be read")
    end
  end

  def answer(session, %{stage: :written} = task, {:ok, _line}),
    do: ask_value(session, task, %{stage: :check})

  def answer(session, %{line: line} = task, {:ok, reply}) do
    case Line.value(line, task.name, reply[:line] || "") do
      {:ok, value} when task.stage == :check ->
        session |> Answers.changed() |> Answers.report(task, value, told(line))

      {:ok, value} ->
        Answers.report(session, task, value, told(line))

      :error ->
        Answers.refuse(session, task, :unknown, "the firmware answers with something else")
    end
  end

  def answer(session, %{stage: :before, param: %{block: block} = param} = task, :refused) when block != nil,
    do: Tasks.ask_next(session, task, Blocks.first(param))

  def answer(session, %{stage: :written} = task, :refused),
    do: Answers.refuse(session, task, :denied, "the flight controller refused it")

  def answer(session, task, :refused),
    do: Answers.refuse(session, task, :unknown, "this firmware does not have it")

  defp ask_value(session, task, changes),
    do: Tasks.ask_next(session, task, Map.put(changes, :ask, Line.get(task.name)))

  defp write(session, task, line) do
    case Line.set(line, task.name, task.value) do
      {:ok, request} -> Tasks.ask_next(session, task, %{stage: :written, line: line, ask: request})
      {:error, why} -> Answers.refuse(session, task, :out_of_range, why)
    end
  end

  @doc "The type by which clients get it."
  @spec told(Line.t()) :: Answers.type()
  def told(line), do: Answers.type(line.type, line.high)

  @doc "What the answer to `Line.info/2` says, with those before it; `{:more, changes}` of the task if its text goes on."
  @spec described(Tasks.task(), map) :: {:ok, Line.t()} | {:more, map} | :text | :error
  def described(%{text: before, name: name}, reply) do
    part = reply[:text] || ""
    text = before <> part

    if part != "" and byte_size(text) < min(reply[:total] || 0, @most_text),
      do: {:more, %{text: text, ask: Line.info(name, byte_size(text))}},
      else: Line.read(text)
  end
end
