defmodule Aerie.Control.Operations.Route do
  @moduledoc """
  How an operation is asked for over REST: a method of a path, whose `:name`s are fields of the operation, but for the
  vehicle's `:id`. A request without a body has the other fields in its query, one with a body has them there.

    * `:query` - fields that stand in the query although there is a body
    * `:given` - fields that the path says by itself; `:omit` - fields that only messages of NATS have;
      `:required` - fields without which an object is not enough
    * `:select` - of several operations on one path, this one is meant if the query has the parameter
    * `:file` - the field that a body is as a whole, when it is no JSON; fields that it may replace are in `:replaces`
    * `:formats` - the forms of a file that `?format=`, `Accept` or `Content-Type` choose, JSON first
    * `:media` - the media types of a body or an answer besides JSON
    * `:change` - what it changes of the gateway, by its name in the audit log
    * `:max_bytes` - the largest body; `:status` - that of the answer
    * `:stream?` - the answer is sent while it comes from the vehicle, by a module of the interface
  """

  @enforce_keys [:method, :path, :summary]
  defstruct [
    :method,
    :path,
    :summary,
    :select,
    :file,
    :change,
    query: [],
    given: %{},
    omit: [],
    required: [],
    replaces: [],
    formats: [],
    media: [],
    max_bytes: 16_384,
    status: 200,
    stream?: false
  ]

  @type t :: %__MODULE__{
          method: String.t(),
          path: String.t(),
          summary: String.t(),
          select: String.t() | nil,
          file: atom() | nil,
          change: atom() | nil,
          query: [atom()],
          given: %{String.t() => term()},
          omit: [atom()],
          required: [atom()],
          replaces: [atom()],
          formats: [String.t()],
          media: [String.t()],
          max_bytes: pos_integer(),
          status: 200..299,
          stream?: boolean()
        }

  for method <- ~w(get post put patch delete)a do
    @doc "A route of #{method |> Atom.to_string() |> String.upcase()}."
    @spec unquote(method)(String.t(), String.t(), keyword()) :: t()
    def unquote(method)(path, summary, options \\ []),
      do:
        struct!(
          %__MODULE__{
            method: unquote(method |> Atom.to_string() |> String.upcase()),
            path: path,
            summary: summary
          },
          options
        )
  end

  @doc "Whether the request has a body."
  @spec body?(t()) :: boolean()
  def body?(%__MODULE__{method: method}), do: method in ["POST", "PUT", "PATCH"]
end
