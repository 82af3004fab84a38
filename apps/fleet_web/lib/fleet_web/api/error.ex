defmodule FleetWeb.API.Error do
  @moduledoc """
  The answer to a refused request: a status and `{"error": {"code": ..., "message": ...}}`.

  The code is for programs and does not change. The message is for people and says what is expected.
  """

  @enforce_keys [:status, :code, :message]
  defstruct [:status, :code, :message, headers: %{}]

  @typedoc """
  * `bad_request` (400) - malformed HTTP or JSON
  * `unauthorized` (401) - no key, or an unknown one
  * `forbidden` (403) - a web page of another server; without a configured key: a request from another machine
  * `not_found` (404), `method_not_allowed` (405), `conflict` (409, the id is taken)
  * `too_large` (413), `unsupported_media_type` (415)
  * `upgrade_required` (426) - plain HTTP where a WebSocket is served
  * `invalid` (422) - well-formed but not possible
  * `too_many` (429) - a limit is reached
  * `unavailable` (503) - the part that would answer does not run
  """
  @type code ::
          :bad_request
          | :unauthorized
          | :forbidden
          | :not_found
          | :method_not_allowed
          | :conflict
          | :too_large
          | :unsupported_media_type
          | :invalid
          | :upgrade_required
          | :too_many
          | :unavailable
  @type t :: %__MODULE__{status: 400..599, code: code(), message: String.t(), headers: map()}

  @statuses %{
    bad_request: 400,
    unauthorized: 401,
    forbidden: 403,
    not_found: 404,
    method_not_allowed: 405,
    conflict: 409,
    too_large: 413,
    unsupported_media_type: 415,
    invalid: 422,
    upgrade_required: 426,
    too_many: 429,
    unavailable: 503
  }

  @doc "Makes an error of a kind, with further headers for the answer."
  @spec new(code(), String.t(), map()) :: t()
  def new(code, message, headers \\ %{}),
    do: %__MODULE__{status: Map.fetch!(@statuses, code), code: code, message: message, headers: headers}

  @doc "The body of the answer, as a map for JSON."
  @spec body(t()) :: map()
  def body(%__MODULE__{code: code, message: message}), do: %{error: %{code: code, message: message}}
end
