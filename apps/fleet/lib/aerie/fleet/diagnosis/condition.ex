defmodule Aerie.Fleet.Diagnosis.Condition do
  @moduledoc """
  Something that is wrong, or soon will be: what, what shows it, and what to do.

  `fields/0` says what each field is; `:subject` is `:gateway`, `{:link, id}`, `{:client, id}` or `{:vehicle, id}`, and `:since`
  is nil before `Aerie.Fleet.Diagnosis.step/2` set it.
  """

  alias Aerie.Base.Json.Object

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

  @fields Object.fields([
            {:name, :text, nil, "what is wrong, for programs"},
            {:severity, {:one_of, [:error, :warning, :notice]}, nil,
             "error: something does not work; warning: it works badly, or is dangerous; notice: worth knowing"},
            {:subject, {:one_of, [:gateway, :link, :client, :vehicle]}, nil, "what it concerns",
             &__MODULE__.kind/1},
            {:id, :text, nil, "which link, client or vehicle", &__MODULE__.id/1},
            {:title, :text, nil, "a sentence for people"},
            {:evidence, {:list, :text}, nil, "what was measured, a line each"},
            {:mend, :text, nil, "what to do, a sentence"},
            {:since, :time, nil, "when it was first noticed"}
          ])

  @doc "What is shown of a condition."
  @spec fields() :: [Object.t()]
  def fields, do: @fields

  @doc false
  @spec kind(t()) :: atom()
  def kind(%{subject: subject}), do: with({kind, _id} <- subject, do: kind)

  @doc false
  @spec id(t()) :: String.t() | nil
  def id(%{subject: subject}), do: with(:gateway <- subject, do: nil, else: ({_kind, id} -> id))

  @doc "What is shown of a condition."
  @spec plain(t()) :: %{atom() => term()}
  def plain(%__MODULE__{} = condition), do: Object.show(@fields, condition)
end
