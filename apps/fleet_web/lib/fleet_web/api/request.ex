defmodule FleetWeb.API.Request do
  @moduledoc "Reads a Cowboy request: the facts for `FleetWeb.API.Access`, and a bounded JSON body."

  alias FleetWeb.API.{Access, Error}

  @max_body 16_384

  @doc "The facts that decide about access."
  @spec facts(:cowboy_req.req()) :: Access.facts()
  def facts(request) do
    {peer, _port} = :cowboy_req.peer(request)

    %{
      peer: peer,
      forwarded: Enum.any?(["forwarded", "x-forwarded-for", "x-real-ip"], &(header(request, &1) != nil)),
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

  @doc "The query's parameters; the last value if one is repeated, and none if the query is malformed."
  @spec parameters(:cowboy_req.req()) :: %{String.t() => String.t() | nil}
  def parameters(request) do
    Map.new(:cowboy_req.parse_qs(request), fn {name, value} -> {name, if(is_binary(value), do: value)} end)
  catch
    :exit, {:request_error, :qs, _reason} -> %{}
  end

  @doc "The body as a JSON object of at most #{@max_body} bytes."
  @spec object(:cowboy_req.req()) :: {:ok, map(), :cowboy_req.req()} | {:error, Error.t(), :cowboy_req.req()}
  def object(request) do
    with :ok <- json?(request), {:ok, text, request} <- body(request), {:ok, object} <- decode(text) do
      {:ok, object, request}
    else
      {:error, error} -> {:error, error, request}
      {:error, error, request} -> {:error, error, request}
    end
  end

  # Any web page may send a form anywhere without a CORS preflight, so a form is never accepted.
  defp json?(request) do
    case String.split(header(request, "content-type") || "", ";", parts: 2) do
      [type | _] ->
        if String.downcase(String.trim(type)) == "application/json",
          do: :ok,
          else: {:error, Error.new(:unsupported_media_type, "the body must be application/json")}
    end
  end

  defp body(request) do
    case :cowboy_req.body_length(request) do
      length when is_integer(length) and length > @max_body -> {:error, too_large()}
      # Short enough, or chunked and of unknown length.
      _length -> read(request)
    end
  end

  defp read(request) do
    case :cowboy_req.read_body(request, %{length: @max_body + 1, period: 5_000}) do
      {:ok, text, request} when byte_size(text) <= @max_body -> {:ok, text, request}
      {_more, text, request} when byte_size(text) > @max_body -> {:error, too_large(), request}
      {:more, _text, request} -> {:error, Error.new(:bad_request, "the body did not arrive in time"), request}
    end
  end

  defp too_large,
    do: Error.new(:too_large, "the body must have at most #{@max_body} bytes", %{"connection" => "close"})

  defp decode(text) do
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
