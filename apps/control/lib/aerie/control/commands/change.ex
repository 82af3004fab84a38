defmodule Aerie.Control.Commands.Change do
  @moduledoc """
  A change of the vehicle that is not a command of the table: setting a parameter, sending a plan, writing a file. It
  has an envelope like a command, so ledger, rates, policy, audit log and metrics treat it like one. It is data, and
  `:module` knows what it means:

      %Change{module: Aerie.Control.Params, what: {:set, "WPNAV_SPEED", 500, nil, nil}, sets: [{"WPNAV_SPEED", 500}], …}
  """

  alias Aerie.Base.Names
  alias Aerie.Control.Commands.Gateways
  alias Aerie.Control.{Policy, TransferExecutor}
  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.Mavlink.SystemId
  alias Aerie.Control.TransferExecutor.Outcome
  alias Aerie.Vehicle.Command.Result

  @enforce_keys [:module, :what, :facts, :params, :limit_ms]
  defstruct [:module, :what, :facts, :params, :limit_ms, :timeout_ms, :remote_request, sets: []]

  @typedoc "What is changed, in the terms of its module."
  @type what :: tuple()

  @typedoc """
    * `:facts` - the intent by which the rules judge it; its type is that of the envelope
    * `:params` - what the audit log records of it
    * `:limit_ms` - its time limit unless one is asked for, which is then `:timeout_ms`
    * `:sets` - the parameters that it sets: one of them may give the vehicle another system id
    * `:remote_request` - the request to the gateway that hears the vehicle; nil: it is not passed on
  """
  @type t :: %__MODULE__{
          module: module(),
          what: what(),
          facts: Intent.t(),
          params: %{atom() => term()},
          limit_ms: pos_integer(),
          timeout_ms: pos_integer() | nil,
          sets: [{String.t(), term()}],
          remote_request: Gateways.request() | nil
        }

  @doc "A further check by the policy before anything is sent."
  @callback review(what(), Names.gateway(), snapshot :: map(), Policy.t(), Context.t()) ::
              :allow | {:deny, Policy.rule(), String.t()}

  @doc """
  The transfer that makes it, or why the vehicle's firmware lacks what is changed. `:details` makes the details of a
  success from the transfer's value, and `:complete` adds to the result what was found out before.
  """
  @callback transfer(what(), Names.gateway(), snapshot :: map()) ::
              {:ok, TransferExecutor.transfer()} | {:gap, String.t()}

  @doc "Makes a change, and reports progress."
  @spec run(t(), Names.gateway(), snapshot :: map(), id :: String.t(), (map() -> :ok)) :: Result.t()
  def run(%{module: module} = change, gateway, snapshot, id, tell) do
    with {:ok, transfer} <- module.transfer(change.what, gateway, snapshot) do
      renamed = renaming(gateway, snapshot, change.sets, id)
      options = [timeout_ms: change.timeout_ms]
      unfolded = fn _event, acc -> acc end
      {result, nil} = TransferExecutor.run(gateway, snapshot.key, id, transfer, options, tell, nil, unfolded)
      complete = Map.get(transfer, :complete, & &1)
      result |> Outcome.of(id) |> result(id, transfer) |> renamed.() |> complete.()
    else
      {:gap, lacking} -> Result.new(id, :rejected, lacking)
    end
  end

  defp result({:ok, value}, id, %{details: details}), do: Result.new(id, :completed, nil, details.(value))
  defp result({:ok, _value}, id, _transfer), do: Result.new(id, :completed)
  defp result({:ended, result}, _id, _transfer), do: result

  # A vehicle that has the new system id answers nothing that the old one was asked.
  defp renaming(gateway, snapshot, sets, id) do
    {asker, ref} = {self(), make_ref()}

    SystemId.follow(gateway, snapshot, sets, fn name ->
      send(asker, {ref, name})
      TransferExecutor.cancel(gateway, snapshot.key, id)
    end)

    fn result ->
      receive do
        {^ref, name} ->
          unanswered? = result.status in [:cancelled, :timeout, :unknown]
          result = if unanswered?, do: %{result | status: :completed, reason: nil}, else: result
          result = put_in(result.details["vehicle_now"], name)
          Result.remark(result, ["the vehicle has the new system id, and is #{name} now"])
      after
        0 -> result
      end
    end
  end
end
