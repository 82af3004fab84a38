defmodule Aerie.Control.CommandExecutor.Repeater do
  @moduledoc """
  The stream of set-points or overrides that is sent to a vehicle: at most one, which a new one replaces (X7). It ends
  when it is not renewed soon enough, and at its deadline, so that a source that died no longer steers. Pure.
  """

  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Protocol.Step

  defstruct [:id, :type, :step, :until, :next_at]

  @type t :: %__MODULE__{
          id: String.t() | nil,
          type: String.t() | nil,
          step: Step.t() | nil,
          until: integer() | nil,
          next_at: integer() | nil
        }

  @type ended :: {id :: String.t(), Step.t()}

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc """
  Starts a stream. Gives the former one, by its id and step, if that has to be given back first: one of the same type
  only changes its values.
  """
  @spec start(t(), Command.t(), Step.t(), deadline :: integer(), now :: integer()) :: {t(), ended() | nil}
  def start(former, command, step, deadline, now) do
    until = min(deadline, now + step.stream.ms * 1000)
    given_back = if former.step != nil and former.type != command.type, do: {former.id, former.step}
    {%__MODULE__{id: command.id, type: command.type, step: step, until: until, next_at: now}, given_back}
  end

  @doc "The next step: another message, the end, or nothing yet."
  @spec tick(t(), now :: integer()) :: {:send, id :: String.t(), Step.t(), t()} | {:end, ended(), t()} | :wait
  def tick(%{step: nil}, _now), do: :wait
  def tick(%{until: until} = ended, now) when now >= until, do: {:end, {ended.id, ended.step}, new()}
  def tick(%{next_at: next_at}, now) when now < next_at, do: :wait

  def tick(repeater, now) do
    # A late repeater does not catch up with a burst.
    period = div(1_000_000, repeater.step.stream.hz)
    next_at = max(repeater.next_at + period, now + div(period, 2))
    {:send, repeater.id, repeater.step, %{repeater | next_at: next_at}}
  end

  @doc "Ends a stream by the id of its command; nil when it is not that one's."
  @spec stop(t(), id :: String.t()) :: {ended(), t()} | nil
  def stop(%{id: id, step: step}, id) when step != nil, do: {{id, step}, new()}
  def stop(_repeater, _id), do: nil

  @doc "When something is due."
  @spec next_at(t()) :: integer() | nil
  def next_at(%{step: nil}), do: nil
  def next_at(repeater), do: min(repeater.next_at, repeater.until)
end
