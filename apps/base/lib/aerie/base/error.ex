defmodule Aerie.Base.Error do
  @moduledoc """
  Why a request to the gateway was refused, as a value that can be matched (`reason`) and read (`Exception.message/1`).
  `hint` says what to do instead, where that is known.

  | `reason` | when |
  |---|---|
  | `{:unknown, kind, id}` | there is no vehicle, link or client of this id; `:owner` is a link or a client |
  | `{:exists, kind, id}` | the id is taken |
  | `{:conflict, text}` | the present state forbids it: the vehicle is armed, another request is in progress |
  | `{:limit, text}` | there are as many as the configuration allows |
  | `{:invalid, text}` | the request is not possible |
  | `{:unavailable, text}` | the part that would do it does not run, does not answer, or has nothing to work on |
  """

  @type kind :: :vehicle | :link | :client | :owner | :recording
  @type reason ::
          {:unknown | :exists, kind(), id :: String.t()}
          | {:conflict | :limit | :invalid | :unavailable, String.t()}

  @type t :: %__MODULE__{reason: reason(), hint: String.t() | nil}

  defexception [:reason, :hint]

  @doc "The error of a reason, with a hint if there is one, as a result."
  @spec new(reason(), String.t() | nil) :: {:error, t()}
  def new(reason, hint \\ nil), do: {:error, %__MODULE__{reason: reason, hint: hint}}

  @doc "The error as one line for a person."
  @impl Exception
  def message(%__MODULE__{hint: hint} = error) when hint != nil,
    do: "#{message(%{error | hint: nil})}; #{hint}"

  def message(%__MODULE__{reason: {:unknown, :vehicle, id}}), do: "no vehicle #{id} is known"
  def message(%__MODULE__{reason: {:unknown, :owner, id}}), do: "there is no link and no client #{id}"
  def message(%__MODULE__{reason: {:unknown, kind, id}}), do: "there is no #{kind} #{id}"
  def message(%__MODULE__{reason: {:exists, kind, id}}), do: "there is already a #{kind} #{id}"
  def message(%__MODULE__{reason: {_kind, text}}), do: text
end
