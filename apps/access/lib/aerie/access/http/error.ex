defmodule Aerie.Access.HTTP.Error do
  @moduledoc """
  The answer to a refused request: a status and `{"error": {"code": ..., "message": ...}}`.

  The code is for programs and does not change. The message is for people and says what is expected. This is a struct of
  its own besides `Aerie.Base.Error`, because most refusals here concern HTTP (keys, methods, sizes, headers), which the
  gateway below does not know; `from/1` gives each error of the gateway its status.
  """

  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.Result

  @enforce_keys [:status, :code, :message]
  defstruct [:status, :code, :message, headers: %{}, details: %{}]

  # What a status means, and the codes that have it; the first one for a rule of `Aerie.Vehicle.Command.Refusal`.
  @table [
    {400, "Malformed HTTP or JSON.", [:bad_request]},
    {401, "No key, or an unknown one.", [:unauthorized]},
    {403, "The key, the page or the machine may not, or the policy denies it.", [:forbidden]},
    {404, "There is no such thing.", [:not_found]},
    {405, "The resource does not take this method.", [:method_not_allowed]},
    {409, "The id is taken, or the present state forbids it.", [:conflict, :cancelled]},
    {410, "The command's deadline has passed.", [:expired]},
    {413, "The body is too large.", [:too_large]},
    {415, "The body has another type.", [:unsupported_media_type]},
    {416, "The range begins after the end.", [:range]},
    {421,
     "Another gateway hears the vehicle, and only that one has this: " <>
       "ask the one that `via` of GET /api/vehicles/{id} names.", [:misdirected]},
    {422, "Well-formed but not possible.", [:invalid]},
    {426, "Plain HTTP where a WebSocket is served.", [:upgrade_required]},
    {429, "A limit is reached.", [:too_many]},
    {502, "The vehicle did not do it.", [:failed]},
    {503, "The part that would answer does not run.", [:unavailable]},
    {504, "The vehicle did not answer; it may have done it.", [:timeout, :outcome_unknown]}
  ]
  @statuses for {status, _meaning, codes} <- @table, code <- codes, into: %{}, do: {code, status}
  @meanings Map.new(@table, fn {status, meaning, _codes} -> {status, meaning} end)
  @by_status Map.new(@table, fn {status, _meaning, [code | _]} -> {status, code} end)

  @typedoc "For programs; one of `codes/0`."
  @type code :: atom()

  @typedoc "`details` are beside `error` in the answer."
  @type t :: %__MODULE__{
          status: 400..599,
          code: code(),
          message: String.t(),
          headers: map(),
          details: map()
        }

  @doc "The codes of all errors."
  @spec codes() :: [code()]
  def codes, do: @statuses |> Map.keys() |> Enum.sort()

  @doc "The meaning of a status."
  @spec meaning(400..599) :: String.t()
  def meaning(status), do: Map.fetch!(@meanings, status)

  @doc "Makes an error of a kind, with further headers for the answer."
  @spec new(code(), String.t(), map()) :: t()
  def new(code, message, headers \\ %{}),
    do: %__MODULE__{status: Map.fetch!(@statuses, code), code: code, message: message, headers: headers}

  # Why an operation was not carried out, as those say it that it asks.
  @reasons %{
    busy: :too_many,
    conflict: :conflict,
    invalid: :invalid,
    limit: :too_large,
    rate: :too_many,
    role: :forbidden,
    unavailable: :unavailable,
    unknown: :not_found
  }
  # Why the gateway below refuses it.
  @codes Map.merge(@reasons, %{exists: :conflict, limit: :too_many})

  @doc "The answer for an error of the gateway or of an operation; an answer is returned unchanged."
  @spec from(
          t()
          | Aerie.Base.Error.t()
          | Result.t()
          | [Command.Error.t(), ...]
          | {atom(), String.t() | Command.Error.t() | [Command.Error.t(), ...]}
        ) :: t()
  def from(%__MODULE__{} = error), do: error

  def from(%Aerie.Base.Error{reason: reason} = error),
    do: new(Map.fetch!(@codes, elem(reason, 0)), Exception.message(error))

  def from(%Result{} = result), do: %__MODULE__{} = of_result(result)
  def from([_ | _] = errors), do: malformed(errors)
  def from({:invalid, %Command.Error{expected: reason}}), do: new(:invalid, reason)
  def from({:malformed, errors}), do: malformed(errors)
  def from({reason, text}), do: new(Map.fetch!(@reasons, reason), text)

  # A command's results; `Aerie.Vehicle.Command.Refusal` has the statuses of rules.
  @results %{
    rejected: :invalid,
    denied: :forbidden,
    failed: :failed,
    cancelled: :cancelled,
    timeout: :timeout,
    unknown: :outcome_unknown,
    expired: :expired
  }

  @doc "The answer for a command that was not done, with its result as details; nil for one that was."
  @spec of_result(Result.t()) :: t() | nil
  def of_result(%Result{status: status}) when status in [:completed, :accepted], do: nil

  def of_result(result) do
    status = Command.Refusal.http(result.details["rule"])
    code = if status, do: Map.fetch!(@by_status, status), else: Map.fetch!(@results, result.status)
    %{new(code, result.reason || Atom.to_string(result.status)) | details: Result.plain(result)}
  end

  @doc "The answer for what only the gateway `via` has, which hears the vehicle."
  @spec misdirected(via :: String.t()) :: t()
  def misdirected(via) do
    {:deny, :elsewhere, message} = Command.Refusal.deny(:elsewhere, via: via)
    %{new(:misdirected, message) | details: %{"rule" => "elsewhere", "gateway" => via}}
  end

  @doc "The answer for an invalid command, with all its errors."
  @spec malformed([Command.Error.t(), ...]) :: t()
  def malformed(errors) do
    plain = for error <- errors, do: error |> Map.from_struct() |> Map.take([:key, :expected, :got])
    details = %{"result" => "rejected", "rule" => "malformed", "errors" => plain}
    %{new(:invalid, Enum.join(errors, "; ")) | details: details}
  end

  @doc "The error for a well-formed request that is not possible."
  @spec invalid(String.t()) :: {:error, t()}
  def invalid(message), do: {:error, new(:invalid, message)}

  @doc "The error for what would be too much at once."
  @spec busy(seconds :: pos_integer()) :: t()
  def busy(seconds),
    do: new(:too_many, "too much at once: try again in #{seconds} s", %{"retry-after" => "#{seconds}"})

  @doc "Answers a request with an error and closes its connection."
  @spec refuse(t(), :cowboy_req.req()) :: :cowboy_req.req()
  def refuse(%__MODULE__{} = error, request) do
    headers = %{
      "content-type" => "application/json; charset=utf-8",
      "cache-control" => "no-store",
      "connection" => "close"
    }

    body = [JSON.encode_to_iodata!(body(error)), ?\n]
    :cowboy_req.reply(error.status, Map.merge(headers, error.headers), body, request)
  end

  @doc "The body of the answer, as a map for JSON."
  @spec body(t()) :: map()
  def body(%__MODULE__{code: code, message: message, details: details}),
    do: Map.put(details, "error", %{code: code, message: message})
end
