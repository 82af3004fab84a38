defmodule Aerie.Vehicle.Events.Detector.Step do
  @moduledoc "An event to be, together with the change of the detector that goes with it."

  @enforce_keys [:type]
  defstruct [:type, data: %{}, changes: [], moment: nil]

  @typedoc """
  When and where something happened: unix us, the vehicle's clock (ms), its position as event data; and when the gateway learned
  of it.
  """
  @type moment :: %{
          at: integer(),
          boot_ms: non_neg_integer() | nil,
          where: map() | nil,
          received: integer()
        }
  @typedoc """
  `type` is nil for a change of the detector alone; `changes` are fields of the detector; `moment` is set if the event
  happened earlier than what showed it.
  """
  @type t :: %__MODULE__{type: String.t() | nil, data: map(), changes: keyword(), moment: moment() | nil}

  @doc "An event."
  @spec event(String.t(), map(), keyword()) :: t()
  def event(type, data \\ %{}, changes \\ []), do: %__MODULE__{type: type, data: data, changes: changes}

  @doc "A change of the detector without an event."
  @spec change(keyword()) :: t()
  def change(changes), do: %__MODULE__{type: nil, changes: changes}

  @doc "The time between two moments as events give it: seconds, to a tenth."
  @spec seconds(from :: integer(), to :: integer()) :: float()
  def seconds(from, to), do: Float.round(max(to - from, 0) / 1_000_000, 1)
end
