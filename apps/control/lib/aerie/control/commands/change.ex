defmodule Aerie.Control.Commands.Change do
  @moduledoc """
  A change of the vehicle that is not a command of the table: setting a parameter, sending a plan, writing a file. It has an envelope like a
  command, so that ledger, rates, policy, audit log and metrics treat it like one.
  """

  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Context, Intent}

  @enforce_keys [:facts, :run]
  defstruct [:facts, :run, :review, :remote_request, :timeout_ms]

  @typedoc """
    * `:facts` - the intent by which the rules judge it; its type is that of the envelope
    * `:review` - a further check by the policy before anything is sent; nil for none
    * `:remote_request` - the request to the gateway that hears the vehicle (`t:Aerie.Control.Commands.Gateways.request/0`); nil: it is
      not passed on
    * `:timeout_ms` - the time limit that was asked for, nil for none
    * `:run` - makes the change, given the vehicle's snapshot and a function that reports progress
  """
  @type t :: %__MODULE__{
          facts: Intent.t(),
          review:
            nil | (Policy.t(), Context.t(), snapshot :: map() -> :allow | {:deny, Policy.rule(), String.t()}),
          timeout_ms: pos_integer() | nil,
          remote_request: nil | Aerie.Control.Commands.Gateways.request(),
          run: (snapshot :: map(), (map() -> :ok) -> Result.t())
        }
end
