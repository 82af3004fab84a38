defmodule Aerie.Control.Commands.Change do
  @moduledoc """
  Work that passes the door without being a command of the table: setting a parameter, sending a plan, writing a file. It has an envelope like a
  command, so that ledger, rates, policy, audit log and metrics treat it like one.
  """

  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Context, Intent}

  @enforce_keys [:facts, :run]
  defstruct [:facts, :run, :review, :elsewhere]

  @typedoc """
    * `:facts` - what the rules judge it by; its type is that of the envelope
    * `:review` - what the rules have to say beyond that, asked before anything is sent; nil for nothing
    * `:elsewhere` - how another gateway is asked to do it to a vehicle that it hears (`t:Aerie.Control.Commands.RemoteGateway.request/0`); nil: it
      is not passed on
    * `:run` - does it, given the vehicle's snapshot and a function for its progress
  """
  @type t :: %__MODULE__{
          facts: Intent.t(),
          review:
            nil | (Policy.t(), Context.t(), snapshot :: map() -> :allow | {:deny, Policy.rule(), String.t()}),
          elsewhere: nil | Aerie.Control.Commands.RemoteGateway.request(),
          run: (snapshot :: map(), (map() -> :ok) -> Result.t())
        }
end
