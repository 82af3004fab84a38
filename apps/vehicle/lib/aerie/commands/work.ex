defmodule Aerie.Commands.Work do
  @moduledoc """
  Work that passes the door without being a command of the table: setting a parameter, sending a plan, writing a file. It has an envelope like a
  command, so that ledger, rates, policy, audit log and metrics treat it like one.
  """

  alias Aerie.Command.Result
  alias Aerie.Policy
  alias Aerie.Policy.{Context, Facts}

  @enforce_keys [:facts, :run]
  defstruct [:facts, :run, :review]

  @typedoc """
    * `:facts` - what the rules judge it by; its type is that of the envelope
    * `:review` - what the rules have to say beyond that, asked before anything is sent; nil for nothing
    * `:run` - does it, given the vehicle's snapshot and a function for its progress
  """
  @type t :: %__MODULE__{
          facts: Facts.t(),
          review:
            nil | (Policy.t(), Context.t(), snapshot :: map() -> :allow | {:deny, Policy.rule(), String.t()}),
          run: (snapshot :: map(), (map() -> :ok) -> Result.t())
        }
end
