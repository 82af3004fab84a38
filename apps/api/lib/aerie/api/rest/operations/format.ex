defmodule Aerie.Api.Rest.Operations.Format do
  @moduledoc """
  The format of a body or an answer: `?format=` chooses it; otherwise the content type of the body, or the first known one of `Accept`.
  Pure.
  """

  alias Aerie.Access.HTTP.Error

  @json "application/json"
  @text "text/plain"
  @bytes "application/octet-stream"
  @xml "application/xml"
  @types %{
    "json" => @json,
    "param" => @text,
    "params" => @text,
    "txt" => @text,
    "plan" => @json,
    "waypoints" => @text,
    "mission" => @xml
  }

  @doc "The content type of a format."
  @spec type(String.t()) :: String.t()
  def type(format), do: Map.fetch!(@types, format) <> "; charset=utf-8"

  @doc "The content type of opaque bytes."
  @spec bytes() :: String.t()
  def bytes, do: @bytes

  @doc """
  One of `formats`, of which the first is JSON and the second the meaning of `text/plain`. `header` is the content type or `Accept`, or
  nil.
  """
  @spec choose(parameter :: String.t() | nil, header :: String.t() | nil, formats :: [String.t(), ...]) ::
          {:ok, String.t()} | {:error, Error.t()}
  def choose(nil, header, [json, text | _more]), do: {:ok, by_header(header, json, text)}

  def choose(given, _header, formats) do
    if given in formats,
      do: {:ok, given},
      else: Error.invalid("format: expected #{Enum.join(formats, ", ")}")
  end

  defp by_header(nil, json, _text), do: json

  defp by_header(header, json, text) do
    header
    |> String.split(",")
    |> Enum.map(&(&1 |> String.split(";") |> hd() |> String.trim() |> String.downcase()))
    |> Enum.find_value(json, fn
      @json -> json
      @text -> text
      _other -> nil
    end)
  end
end
