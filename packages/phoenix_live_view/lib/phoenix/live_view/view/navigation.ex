defmodule Phoenix.LiveView.View.Navigation do
  @moduledoc "A view's request to navigate, as a value in its socket."

  alias Phoenix.LiveView.Socket

  @type t :: {:patch, %{to: String.t(), kind: :push | :replace}} | {:redirect, %{to: String.t()}}

  @spec ask(Socket.t(), :patch | :redirect, keyword()) :: Socket.t()
  def ask(%Socket{redirected: nil} = socket, :redirect, options),
    do: %{socket | redirected: {:redirect, %{to: local!(options[:to])}}}

  def ask(%Socket{redirected: nil} = socket, :patch, options) do
    kind = if options[:replace], do: :replace, else: :push
    %{socket | redirected: {:patch, %{to: local!(options[:to]), kind: kind}}}
  end

  def ask(%Socket{redirected: redirected}, _how, _options),
    do: raise(ArgumentError, "the socket goes elsewhere already: #{inspect(redirected)}")

  @doc "A link's target: a path, or an http or https URL."
  @spec href!(String.t(), String.t()) :: String.t()
  def href!(href, what) when is_binary(href) do
    case URI.new(href) do
      {:ok, %URI{scheme: scheme}} when scheme in [nil, "http", "https"] ->
        href

      {:ok, %URI{scheme: scheme}} ->
        raise ArgumentError, "unsupported scheme #{inspect(scheme)} given to #{what}"

      {:error, _part} ->
        raise ArgumentError, "expected a path or a URL in #{what}, got: #{inspect(href)}"
    end
  end

  # A path of this server; a text that browsers could read as another server's address is refused.
  defp local!("/" <> rest = path) do
    if String.starts_with?(rest, "/") or String.contains?(path, ["\\", "\t", "\n", "\r"]) or control?(path),
      do: raise(ArgumentError, "expected a path of this server in to:, got: #{inspect(path)}"),
      else: path
  end

  defp local!(other), do: raise(ArgumentError, "expected a path in to:, got: #{inspect(other)}")

  defp control?(path), do: for(<<byte <- path>>, byte < 0x20 or byte == 0x7F, do: byte) != []
end
