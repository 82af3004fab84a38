defmodule Aerie.Fleet.Diagnosis.Condition do
  @moduledoc """
  Something that is wrong, or soon will be: what, what shows it, and what to do.

  - `name`: for programs, one of `Aerie.Fleet.Diagnosis.names/0`
  - `severity`: `:error` (something does not work), `:warning` (it works badly, or is dangerous), `:notice` (worth knowing)
  - `subject`: `:gateway`, `{:link, id}`, `{:client, id}` or `{:vehicle, id}`
  - `title`, `mend`: one sentence each, for people; `evidence`: what was measured, a line each
  - `since`: unix microseconds of when it was first noticed; nil before `Aerie.Fleet.Diagnosis.step/2` set it
  """

  @enforce_keys [:name, :severity, :subject, :title, :mend]
  defstruct [:name, :severity, :subject, :title, :mend, :since, evidence: []]

  @type severity :: :error | :warning | :notice
  @type subject ::
          :gateway | {:link, String.t()} | {:client, String.t()} | {:vehicle, String.t()}
  @type t :: %__MODULE__{
          name: atom(),
          severity: severity(),
          subject: subject(),
          title: String.t(),
          mend: String.t(),
          since: integer() | nil,
          evidence: [String.t()]
        }

  @doc "A condition; `fields` are `title`, `mend`, `evidence`."
  @spec new(atom(), severity(), subject(), keyword()) :: t()
  def new(name, severity, subject, fields),
    do: struct!(__MODULE__, [name: name, severity: severity, subject: subject] ++ fields)

  @doc "The order in which conditions are listed: the most serious first, then by subject and name."
  @spec rank(t()) :: term()
  def rank(%{severity: severity, subject: subject, name: name}),
    do: {Enum.find_index([:error, :warning, :notice], &(&1 == severity)), inspect(subject), name}

  @doc "Plain values by text keys, for JSON."
  @spec plain(t()) :: %{String.t() => term()}
  def plain(%__MODULE__{} = condition) do
    {kind, id} = with :gateway <- condition.subject, do: {:gateway, nil}

    %{
      "name" => Atom.to_string(condition.name),
      "severity" => Atom.to_string(condition.severity),
      "subject" => Atom.to_string(kind),
      "id" => id,
      "title" => condition.title,
      "evidence" => condition.evidence,
      "mend" => condition.mend,
      "since" => condition.since && Aerie.Base.Json.time(condition.since)
    }
  end
end
