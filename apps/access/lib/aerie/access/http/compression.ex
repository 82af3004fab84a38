defmodule Aerie.Access.HTTP.Compression do
  @moduledoc """
  Compresses texts (HTML, JSON, metrics …) for clients that accept gzip: a stream handler of Cowboy in front of its own.
  What is small, very long, sent from a file, compressed already or not a text is left alone.

  A page has a token that nobody else may learn. Its length cannot be tried out from other sites, because browsers send
  the console's cookie (SameSite) only when somebody goes to the page.
  """

  @behaviour :cowboy_stream

  @least 300
  # What takes longer would hold its connection up.
  @most 4_000_000
  @texts ~r{\A(?:text/|application/(?:[a-z.+-]*json|javascript|xml|yaml))}

  @doc "Whether a client accepts gzip, by its header `Accept-Encoding`."
  @spec accepted?(:cowboy_req.req()) :: boolean()
  def accepted?(request) do
    case request do
      %{headers: %{"accept-encoding" => accepted}} ->
        accepted =~ ~r/\bgzip\b(?!\s*;\s*q=0(?:\.0*)?(?:\s|,|$))/

      _none ->
        false
    end
  end

  @impl :cowboy_stream
  def init(id, request, options) do
    {commands, next} = :cowboy_stream.init(id, request, options)
    fold(commands, %{next: next, gzip?: accepted?(request)})
  end

  @impl :cowboy_stream
  def data(id, fin, data, state) do
    {commands, next} = :cowboy_stream.data(id, fin, data, state.next)
    fold(commands, %{state | next: next})
  end

  @impl :cowboy_stream
  def info(id, info, state) do
    {commands, next} = :cowboy_stream.info(id, info, state.next)
    fold(commands, %{state | next: next})
  end

  @impl :cowboy_stream
  def terminate(id, reason, state), do: :cowboy_stream.terminate(id, reason, state.next)

  @impl :cowboy_stream
  def early_error(id, reason, request, response, options),
    do: :cowboy_stream.early_error(id, reason, request, response, options)

  defp fold(commands, state), do: {Enum.map(commands, &command(&1, state.gzip?)), state}

  # Caches have to know that the answer depends on the header, whichever of both they see.
  defp command({:response, status, %{"content-type" => type} = headers, body}, gzip?)
       when not is_map_key(headers, "content-encoding") and not is_map_key(headers, "etag") and
              (is_binary(body) or is_list(body)) do
    type = IO.iodata_to_binary(type)
    size = IO.iodata_length(body)

    cond do
      size < @least or size > @most or not (type =~ @texts) -> {:response, status, headers, body}
      gzip? -> gzip(status, varied(headers), body)
      true -> {:response, status, varied(headers), body}
    end
  end

  defp command(other, _gzip?), do: other

  defp gzip(status, headers, body) do
    body = :zlib.gzip(body)
    headers = Map.merge(headers, %{"content-encoding" => "gzip", "content-length" => "#{byte_size(body)}"})
    {:response, status, headers, body}
  end

  defp varied(headers) do
    Map.update(headers, "vary", "accept-encoding", &[&1, ", accept-encoding"])
  end
end
