defmodule Aerie.Incident.Hide do
  @moduledoc """
  Takes secrets out of what goes into an incident: the secrets of the configuration wherever they appear, passwords in URLs, and values
  whose name says that they are secret. Pure.

  Recordings have no keys and no signatures (S9). Frames that carry other secrets (`frame?/1`) are left out.
  """

  alias Aerie.Base.Secret
  alias MavCodec.Frame
  alias MavCodec.Signing.Redact

  @hidden "(hidden)"
  # A shorter one would be found in ordinary words.
  @shortest 6
  @names ~r/pass(word|wd|key|phrase)|secret|token|credential|private|seed\z|(\A|_)(api|secret|signing|shadow)?_?key\z|(\A|_)pin\z/i
  @url ~r{://[^/@\s"]+@}

  @setup_signing 256

  @doc "Whether a frame has a secret. SETUP_SIGNING stays, and the writer takes its key out."
  @spec frame?(Frame.t()) :: boolean()
  def frame?(%Frame{id: @setup_signing}), do: false
  def frame?(frame), do: Redact.secret?(frame)

  @doc "All secrets of a configuration, or of any other term."
  @spec secrets(term()) :: [String.t()]
  def secrets(term) do
    term
    |> find()
    |> Enum.flat_map(&[&1, String.trim(&1)])
    |> Enum.filter(&(byte_size(&1) >= @shortest))
    |> Enum.uniq()
    |> Enum.sort_by(&{-byte_size(&1), &1})
  end

  defp find(%_struct{} = struct) do
    case Secret.hidden(struct) do
      {:ok, text} -> [text]
      :error -> struct |> Map.from_struct() |> find()
    end
  end

  defp find(map) when is_map(map), do: map |> Map.values() |> Enum.flat_map(&find/1)
  defp find(list) when is_list(list), do: Enum.flat_map(list, &find/1)
  defp find(tuple) when is_tuple(tuple), do: tuple |> Tuple.to_list() |> find()
  defp find(_other), do: []

  @doc "Plain values without secrets."
  @spec plain(term(), [String.t()]) :: term()
  def plain(map, secrets) when is_map(map) do
    Map.new(map, fn {key, value} ->
      name = text(to_string(key), secrets)
      {name, if(is_binary(value) and name =~ @names, do: @hidden, else: plain(value, secrets))}
    end)
  end

  def plain(list, secrets) when is_list(list), do: Enum.map(list, &plain(&1, secrets))
  def plain(text, secrets) when is_binary(text), do: text(text, secrets)
  def plain(other, _secrets), do: other

  @doc "A text without secrets."
  @spec text(String.t(), [String.t()]) :: String.t()
  def text(text, secrets) do
    text = if secrets == [], do: text, else: String.replace(text, secrets, @hidden)
    String.replace(text, @url, "://" <> @hidden <> "@")
  end
end
