defmodule Aerie.Api.Rest.Operations.LogDownload do
  @moduledoc """
  A log of a vehicle as the body of an answer, while it comes from the vehicle: nothing is stored here. `Range: bytes=N-` goes on where
  another download ended; with `If-Range` and the `ETag` of that one only if it is the same log.

  The answer begins with the first byte. What fails later closes the connection, so the client sees fewer bytes than were promised.
  """

  alias Aerie.Control.Logs
  alias Aerie.Access.HTTP.{Error, Request}

  @chunk 16_384
  # Pieces of up to 90 bytes that wait for a client that reads more slowly than the vehicle sends.
  @max_waiting 50_000

  @type result ::
          {:ok, 200 | 206, :sent, :cowboy_req.req()} | {:error, Error.t() | map()}

  @doc "Answers with the log whose id is in the path."
  @spec run({Aerie.Base.Names.gateway(), String.t()}, keyword(), :cowboy_req.req()) ::
          result()
  def run({gateway, vehicle}, options, request) do
    with {:ok, id} <- id(:cowboy_req.binding(:log, request)),
         {:ok, entry} <- Logs.entry(gateway, vehicle, id, options),
         {:ok, status, offset} <- range(entry, request) do
      head = {status, headers(vehicle, entry, status, offset)}

      if :cowboy_req.method(request) == "HEAD" or entry.size == offset,
        do: {:ok, status, :sent, finish(start(head, request))},
        else: send_log({gateway, vehicle}, entry, offset, options, head, request)
    end
  end

  defp id(text) do
    case Integer.parse(text) do
      {id, ""} when id in 0..0xFFFF -> {:ok, id}
      _other -> {:error, Error.new(:not_found, "a log has a number; see /api/vehicles/ID/logs")}
    end
  end

  # Other ranges than one to the end are ignored, as HTTP allows.
  defp range(%{size: size} = entry, request) do
    with {:bytes, [{from, :infinity}]} when from > 0 <- ranges(request),
         true <- Request.header(request, "if-range") in [nil, etag(entry)] do
      if from < size, do: {:ok, 206, from}, else: {:error, beyond(size)}
    else
      _all_of_it -> {:ok, 200, 0}
    end
  end

  defp ranges(request) do
    :cowboy_req.parse_header("range", request)
  catch
    :exit, {:request_error, _header, _reason} -> :undefined
  end

  defp beyond(size),
    do:
      Error.new(:range, "the log has #{size} bytes; ask for a range that begins before its end", %{
        "content-range" => "bytes */#{size}"
      })

  # The id alone may be another log's after a restart.
  defp etag(%{time: nil} = entry), do: ~s("#{entry.id}-#{entry.size}")
  defp etag(entry), do: ~s("#{entry.id}-at-#{entry.time}")

  defp headers(vehicle, entry, status, offset) do
    name = "#{vehicle}-log-#{entry.id}.bin"

    common = %{
      "content-type" => "application/octet-stream",
      "content-disposition" => ~s(attachment; filename="#{name}"),
      "content-length" => Integer.to_string(entry.size - offset),
      "accept-ranges" => "bytes",
      "etag" => etag(entry)
    }

    if status == 206,
      do: Map.put(common, "content-range", "bytes #{offset}-#{entry.size - 1}/#{entry.size}"),
      else: common
  end

  # --- The body. `{request, bytes that wait}`; the request is `{:not_begun, head, request}` before the first byte.

  defp send_log({gateway, vehicle}, entry, offset, options, {status, _headers} = head, request) do
    {result, {sending, waiting}} =
      Logs.fold(gateway, vehicle, entry, offset, {{:not_begun, head, request}, []}, &put/2, options)

    case {result, sending} do
      {{:ok, _size}, sending} -> {:ok, status, :sent, finish(flush(sending, waiting))}
      {{:error, result}, {:not_begun, _head, _request}} -> {:error, result}
      {{:error, _result}, request} -> {:ok, status, :sent, request}
    end
  end

  defp put(bytes, {sending, waiting}) do
    waiting = [waiting | bytes]

    if IO.iodata_length(waiting) < @chunk and not match?({:not_begun, _, _}, sending),
      do: {sending, waiting},
      else: {flush(sending, waiting), []}
  end

  defp flush({:not_begun, head, request}, waiting), do: flush(start(head, request), waiting)

  defp flush(request, waiting) do
    # Its connection is closed; the transfer ends with this process.
    {:message_queue_len, behind} = Process.info(self(), :message_queue_len)
    if behind > @max_waiting, do: exit({:shutdown, :slow_client})
    :ok = :cowboy_req.stream_body(waiting, :nofin, request)
    request
  end

  defp start({status, headers}, request), do: :cowboy_req.stream_reply(status, headers, request)

  defp finish(request) do
    :ok = :cowboy_req.stream_body("", :fin, request)
    request
  end
end
