defmodule Aerie.Vehicle.Command.Result do
  @moduledoc """
  What became of a command. Every command gets exactly one terminal result, and it says what the vehicle did as far as that
  can be known: no answer is `:unknown` or `:timeout`, never "failed" and never "ok".
  """

  # Status, what it means, whether the vehicle may have done it.
  @table [
    {:completed, "the vehicle's state shows that it does what it was told", true},
    {:accepted, "the vehicle accepted it; nothing in its state shows more", true},
    {:rejected,
     "it cannot be done: a wrong parameter, something that this firmware lacks, or the vehicle refused it",
     false},
    {:denied, "Aerie does not let this source do it now: authentication, policy, rate or lease", false},
    {:failed, "the vehicle tried and failed, or accepted it and its state shows that it did not do it",
     false},
    {:cancelled, "it was cancelled before it was done", true},
    {:timeout, "the vehicle is heard, but in the time given neither its answer nor its state showed it",
     true},
    {:unknown, "it was sent, and there is no way to tell whether the vehicle did it", true},
    {:expired, "its deadline passed before it was sent", false}
  ]
  @statuses Enum.map(@table, &elem(&1, 0))
  @by_name Map.new(@statuses, &{Atom.to_string(&1), &1})

  @enforce_keys [:id, :status]
  defstruct [:id, :status, :reason, details: %{}]

  @type status ::
          :completed
          | :accepted
          | :rejected
          | :denied
          | :failed
          | :cancelled
          | :timeout
          | :unknown
          | :expired

  @typedoc """
    * `:reason` - a sentence for people; nil only for a plain success
    * `:details` - plain values beside it, such as `mav_result`, `retries` or `ms`; `remarks` are sentences
  """
  @type t :: %__MODULE__{
          id: String.t(),
          status: status(),
          reason: String.t() | nil,
          details: %{optional(String.t()) => String.t() | number() | boolean() | nil | [String.t()]}
        }

  @doc "All results with their meaning, and whether the vehicle may have done it."
  @spec table() :: [{status(), String.t(), boolean()}]
  def table, do: @table

  @doc "The status of a name, as a ledger or a peer writes it."
  @spec status(String.t()) :: {:ok, status()} | :error
  def status(name), do: Map.fetch(@by_name, name)

  @spec new(String.t(), status(), String.t() | nil, map()) :: t()
  def new(id, status, reason \\ nil, details \\ %{}) when status in @statuses,
    do: %__MODULE__{id: id, status: status, reason: reason, details: details}

  @doc "The result with remarks after those that it has."
  @spec remark(t(), [String.t()]) :: t()
  def remark(result, []), do: result

  def remark(result, remarks),
    do: %{result | details: Map.update(result.details, "remarks", remarks, &(&1 ++ remarks))}

  @doc "The result as NATS and REST have it."
  @spec plain(t()) :: %{String.t() => term()}
  def plain(result) do
    Map.merge(result.details, %{
      "id" => result.id,
      "result" => Atom.to_string(result.status),
      "reason" => result.reason
    })
  end
end
