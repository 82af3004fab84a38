defmodule Aerie.Control.Commands.Gateways.Sending do
  @moduledoc """
  Decides whether this gateway may send a command to a vehicle that others may hear as well. A pure value for one
  command; `Aerie.Control.Commands.Pipeline` asks what it wants to know and does what it says.

  One gateway holds the vehicle. It sends a command when it has claimed the command's id where all of them see it, and
  only while its lease lasts. The others pass the command on to it. A gateway that does not know whether it holds the
  vehicle sends nothing, but for what holds the vehicle or brings it down (`urgent?`): no lease keeps that from it, and
  at worst it arrives twice. A gateway that is alone needs no lease, and its own ledger is enough.

      look ──▶ held ──▶ claiming ──▶ claimed ──▶ send
        │└ pass_on         └ known (somebody has claimed it)
        └ again, refuse

  Times are milliseconds of a clock that never jumps.
  """

  alias Aerie.Vehicle.Command.Refusal

  @again_ms 50

  @enforce_keys [:until, :relayed?]
  defstruct [:until, :relayed?, :lease, urgent?: false, stage: :look]

  @typedoc """
    * `:until` - until when it waits to know who holds the vehicle
    * `:relayed?` - it came over NATS, so it is not passed on
    * `:urgent?` - it holds the vehicle or brings it down
  """
  @type t :: %__MODULE__{
          until: integer(),
          relayed?: boolean(),
          urgent?: boolean(),
          lease: :alone | integer() | nil,
          stage: :look | :held | :claiming | :claimed | :over
        }

  @typedoc """
  The gateway that holds the vehicle: no other can, this one until a time, another one by its name, or why it is not
  known.
  """
  @type holder :: :alone | {:mine, until :: integer()} | {:other, String.t()} | {:unknown, String.t()}
  @type event ::
          {:holder, holder(), now :: integer()}
          | {:claimed, :ok | {:taken, term()} | {:error, String.t()}}
  @type action ::
          {:again, ms :: pos_integer()}
          | {:pass_on, String.t()}
          | :go_on
          | :claim
          | {:send, :fleet | :gateway | :urgent}
          | {:known, term()}
          | {:refuse, Refusal.denial()}

  @spec new(until :: integer(), relayed? :: boolean(), urgent? :: boolean()) :: t()
  def new(until, relayed?, urgent? \\ false),
    do: %__MODULE__{until: until, relayed?: relayed?, urgent?: urgent?}

  @doc """
  What follows from what is known. Events: who holds the vehicle (`:holder`, at the beginning, and again right before
  the claim and right before the first message), and what became of the claim.
  """
  @spec handle(t(), event()) :: {t(), action()}
  def handle(%{stage: :look} = state, {:holder, holder, now}) do
    case lease(holder, now) do
      {:ok, lease} -> {%{state | stage: :held, lease: lease}, :go_on}
      {:other, _name} when state.relayed? and state.urgent? -> {%{state | stage: :held}, :go_on}
      {:other, name} -> other(state, name)
      {:unknown, _why} when now < state.until -> {state, {:again, @again_ms}}
      {:unknown, _why} when state.urgent? -> {%{state | stage: :held}, :go_on}
      {:unknown, why} -> refused(state, Refusal.deny(:holder_unknown, unknown: why))
    end
  end

  def handle(%{stage: :held} = state, {:holder, holder, now}) do
    case lease(holder, now) do
      {:ok, lease} -> {%{state | stage: :claiming, lease: lease}, :claim}
      _lost when state.urgent? -> {%{state | stage: :claiming, lease: nil}, :claim}
      {:other, name} -> refused(state, Refusal.deny(:taken_over, name: name))
      {:unknown, why} -> refused(state, Refusal.deny(:holder_unknown, unknown: why))
    end
  end

  def handle(%{stage: :claiming} = state, {:claimed, :ok}), do: {%{state | stage: :claimed}, :go_on}

  # It may arrive twice. Claims have no seal: any program that reaches NATS can make one.
  def handle(%{stage: :claiming, urgent?: true} = state, {:claimed, _taken_or_error}),
    do: {%{state | stage: :claimed}, :go_on}

  def handle(%{stage: :claiming} = state, {:claimed, {:taken, what}}), do: over(state, {:known, what})

  # Nobody else could have claimed it.
  def handle(%{stage: :claiming, lease: :alone} = state, {:claimed, {:error, _why}}),
    do: {%{state | stage: :claimed}, :go_on}

  def handle(%{stage: :claiming} = state, {:claimed, {:error, why}}),
    do: refused(state, Refusal.deny(:unclaimed, error: why))

  def handle(%{stage: :claimed} = state, {:holder, holder, now}) do
    case lease(holder, now) do
      {:ok, :alone} -> over(state, {:send, :gateway})
      {:ok, _until} -> over(state, {:send, :fleet})
      _lost when state.urgent? -> over(state, {:send, :urgent})
      _lost -> refused(state, Refusal.deny(:holder_lost))
    end
  end

  defp other(%{relayed?: true} = state, name), do: refused(state, Refusal.deny(:held, name: name))
  defp other(state, name), do: over(state, {:pass_on, name})

  defp lease(:alone, _now), do: {:ok, :alone}
  defp lease({:mine, until}, now) when now < until, do: {:ok, until}
  defp lease({:mine, _until}, _now), do: {:unknown, Refusal.text(:lease_ended)}
  defp lease(other_or_unknown, _now), do: other_or_unknown

  defp refused(state, denial), do: over(state, {:refuse, denial})
  defp over(state, action), do: {%{state | stage: :over}, action}
end
