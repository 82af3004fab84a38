defmodule Msp.Session.Params.Lines do
  @moduledoc """
  One parameter of Betaflight from API 1.48 on, by name: what it is, then its value. To set it, a line is written that the firmware checks, and its value is
  read again. A build without a command line refuses the first question: then its block is used.
  """
  @behaviour Msp.Session.Params

  alias Msp.Params.Line
  alias Msp.Session.Params.Answers
  alias Msp.Session.Tasks

  @most_text 8_192

  @doc "The first request; `param` is its row in the table, nil if it has none."
  @spec first(String.t(), MavCodec.Msp.Params.t() | nil) :: map
  def first(name, param),
    do: %{by: __MODULE__, param: param, ask: Line.info(name, 0), stage: :before, text: ""}

  @impl Msp.Session.Params
  def again(task), do: Line.get(task.name)

  @impl Msp.Session.Params
  def read(%{stage: :before} = task, reply) do
    case described(task, reply) do
      {:more, changes} -> {:more, changes}
      {:ok, line} when task.what == :read -> {:more, %{stage: :value, known: line, ask: Line.get(task.name)}}
      {:ok, line} -> {:ok, line, nil, told(line)}
      :text -> {:error, "it is text, which MAVLink's parameters cannot be"}
      :error -> {:error, "what the firmware says of it cannot be read"}
    end
  end

  def read(%{known: line} = task, reply) do
    case Line.value(line, task.name, reply[:line] || "") do
      {:ok, value} -> {:ok, line, value, told(line)}
      :error -> {:error, "the firmware answers with something else"}
    end
  end

  @impl Msp.Session.Params
  def write(task, line) do
    with {:ok, request} <- Line.set(line, task.name, task.value), do: {:ok, request, nil}
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
