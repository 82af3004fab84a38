defmodule Aerie.Console.Map.Tiles.Fetcher.Answer do
  @moduledoc """
  What a tile server's answer means. Pure. A tile is recognised by its first bytes, because it is served under our
  name: the page of a hotspot that wants a click is refused. It is kept for a week at least, whatever the server says,
  and for two months at most.
  """

  alias Aerie.Console.Map.Tiles.Cache

  @week_s 7 * 86_400
  @most_s 60 * 86_400
  @absent_s 86_400
  @most_wait_s 3_600

  @type kind :: :raster | :vector
  @typedoc "An error has the seconds to leave the server alone, if it said so."
  @type t :: {:ok, Cache.entry()} | {:error, String.t(), wait_s :: non_neg_integer() | nil}

  @doc "The meaning of an answer for a tile of a kind. `held` is what the question named by its ETag."
  @spec read(
          {:ok, pos_integer(), map(), binary()} | {:error, String.t()},
          kind(),
          Cache.entry() | nil,
          now :: integer()
        ) ::
          t()
  def read({:ok, 304, headers, _body}, _kind, %{} = held, now),
    do: {:ok, %{held | until: until(headers, now), etag: headers["etag"] || held.etag}}

  def read({:ok, status, _headers, _body}, _kind, _held, now) when status in [204, 404, 410],
    do: {:ok, %{type: nil, gzip?: false, etag: nil, until: now + @absent_s, body: ""}}

  def read({:ok, 200, headers, body}, kind, _held, now) do
    case type(kind, body) do
      {type, gzip?} ->
        {:ok,
         %{type: type, gzip?: gzip?, etag: etag(headers["etag"]), until: until(headers, now), body: body}}

      nil ->
        {:error, "it answered with something other than a tile of #{kind} (#{said(headers)})", nil}
    end
  end

  def read({:ok, status, headers, _body}, _kind, _held, _now) when status in [401, 403],
    do: {:error, "it refuses us (#{status}): is the key right?", wait(headers) || 60}

  def read({:ok, status, headers, _body}, _kind, _held, _now),
    do: {:error, "it answered #{status}", wait(headers)}

  def read({:error, words}, _kind, _held, _now), do: {:error, words, nil}

  defp type(:vector, <<31, 139, _::binary>>), do: {"application/x-protobuf", true}
  # Layers are field 3 of a tile.
  defp type(:vector, <<0x1A, _::binary>>), do: {"application/x-protobuf", false}
  defp type(:vector, _other), do: nil
  defp type(:raster, <<0x89, "PNG\r\n", 0x1A, "\n", _::binary>>), do: {"image/png", false}
  defp type(:raster, <<0xFF, 0xD8, 0xFF, _::binary>>), do: {"image/jpeg", false}
  defp type(:raster, <<"RIFF", _size::32, "WEBP", _::binary>>), do: {"image/webp", false}
  defp type(:raster, _other), do: nil

  defp etag(text) when is_binary(text) and byte_size(text) <= 200, do: if(String.printable?(text), do: text)
  defp etag(_none), do: nil

  defp until(headers, now) do
    said =
      case Regex.run(~r/\bmax-age=(\d{1,9})\b/, headers["cache-control"] || "") do
        [_all, seconds] -> String.to_integer(seconds)
        nil -> 0
      end

    now + (said |> max(@week_s) |> min(@most_s))
  end

  defp wait(headers) do
    case Integer.parse(headers["retry-after"] || "") do
      {seconds, ""} when seconds > 0 -> min(seconds, @most_wait_s)
      _none_or_a_date -> nil
    end
  end

  defp said(headers) do
    case Regex.run(~r|\A[a-z0-9.+/-]{1,60}|i, headers["content-type"] || "") do
      [type] -> type
      nil -> "no type given"
    end
  end
end
