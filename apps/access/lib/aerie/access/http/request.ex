defmodule Aerie.Access.HTTP.Request do
  @moduledoc "Reads a Cowboy request: the facts for `Aerie.Access.HTTP.Admission`, and a bounded JSON body."

  alias Aerie.Access.HTTP.{Admission, Error}

  @forwarded ~w(forwarded x-forwarded-for x-forwarded-proto x-forwarded-host x-real-ip)

  @doc "The facts that decide access."
  @spec facts(:cowboy_req.req()) :: Admission.facts()
  def facts(request) do
    {peer, _port} = :cowboy_req.peer(request)

    %{
      peer: peer,
      forwarded: Enum.any?(@forwarded, &(header(request, &1) != nil)),
      host: header(request, "host"),
      origin: header(request, "origin"),
      key: header(request, "x-aerie-key") || bearer(header(request, "authorization"))
    }
  end

  @doc "A header, or nil if absent."
  @spec header(:cowboy_req.req(), String.t()) :: String.t() | nil
  def header(request, name) do
    case :cowboy_req.header(name, request) do
      :undefined -> nil
      value -> value
    end
  end

  @doc "The query's parameters; the last value of a repeated one, and none if the query is malformed."
  @spec parameters(:cowboy_req.req()) :: %{String.t() => String.t() | nil}
  def parameters(request) do
    Map.new(:cowboy_req.parse_qs(request), fn {name, value} -> {name, if(is_binary(value), do: value)} end)
  catch
    :exit, {:request_error, :qs, _reason} -> %{}
  end

  @doc "The bytes of a body that says that it is JSON, up to a number of them."
  @spec json(:cowboy_req.req(), pos_integer()) ::
          {:ok, binary(), :cowboy_req.req()} | {:error, Error.t(), :cowboy_req.req()}
  def json(request, max) do
    case json?(request) do
      :ok -> bytes(request, max)
      {:error, error} -> {:error, error, request}
    end
  end

  @doc "The raw body, up to a number of bytes."
  @spec bytes(:cowboy_req.req(), pos_integer()) ::
          {:ok, binary(), :cowboy_req.req()} | {:error, Error.t(), :cowboy_req.req()}
  def bytes(request, max) do
    with {:error, error} <- body(request, max), do: {:error, error, request}
  end

  @doc "Lets the answer take this long (ms). Otherwise the connection is closed while the client sends nothing."
  @spec patient(:cowboy_req.req(), pos_integer()) :: :cowboy_req.req()
  def patient(request, timeout_ms) do
    :ok = :cowboy_req.cast({:set_options, %{idle_timeout: timeout_ms + 30_000}}, request)
    request
  end

  # Any web page may send forms anywhere without a CORS preflight, so forms are never accepted. Nor is a request without
  # a body, which it may send as well.
  defp json?(request) do
    case String.split(header(request, "content-type") || "", ";", parts: 2) do
      [type | _] ->
        if String.downcase(String.trim(type)) == "application/json",
          do: :ok,
          else:
            {:error,
             Error.new(:unsupported_media_type, "the body must be application/json" <> empty(request))}
    end
  end

  defp empty(request),
    do:
      if(:cowboy_req.body_length(request) == 0,
        do: "; this request has none: send {} with that type",
        else: ""
      )

  defp body(request, max) do
    case :cowboy_req.body_length(request) do
      length when is_integer(length) and length > max -> {:error, too_large(max)}
      # Short enough, or of unknown length because it is chunked.
      _length -> read(request, max)
    end
  end

  defp read(request, max) do
    case :cowboy_req.read_body(request, %{length: max + 1, period: period(max)}) do
      {:ok, text, request} when byte_size(text) <= max -> {:ok, text, request}
      {_more, text, request} when byte_size(text) > max -> {:error, too_large(max), request}
      {:more, _text, request} -> {:error, Error.new(:bad_request, "the body did not arrive in time"), request}
    end
  end

  # Five seconds, plus the time that a slow network needs for a large body.
  defp period(max), do: 5_000 + div(max, 500)

  defp too_large(max),
    do: Error.new(:too_large, "the body must have at most #{max} bytes", %{"connection" => "close"})

  @doc "A body as a JSON object."
  @spec decode(binary()) :: {:ok, map()} | {:error, Error.t()}
  def decode(text) do
    case JSON.decode(text) do
      {:ok, object} when is_map(object) -> {:ok, object}
      {:ok, _other} -> {:error, Error.new(:bad_request, "the body must be a JSON object")}
      {:error, _reason} -> {:error, Error.new(:bad_request, "the body is not JSON")}
    end
  end

  defp bearer(text) when is_binary(text) do
    case String.split(text, " ", parts: 2) do
      [scheme, key] -> if String.downcase(scheme) == "bearer", do: String.trim(key)
      _other -> nil
    end
  end

  defp bearer(nil), do: nil
end
