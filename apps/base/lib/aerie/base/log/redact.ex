defmodule Aerie.Base.Log.Redact do
  @moduledoc """
  Removes from a text what looks like a secret: the login in a URL, and the value behind a word such as `password`, `token` or
  `x-aerie-key`. Pure.

  This is the second line of defence. The first is that secrets are not put into the log: they are `Aerie.Base.Secret`, and states
  hide their keys. But libraries write their own crash reports, with the headers of requests, for example.
  """

  @login ~r{(\w://)[^\s/@"'<>]+@}
  @named ~r{((?:password|passwd|\btoken|\bsecret|\bseed|\bjwt|api[_-]?key|x-aerie-key|aerie-signature|authorization|cookie)"?'?(?:>>)?\s*(?:=>|[=:,])\s*(?:<<)?["']?)((?:bearer |basic )?[^\s"',;&\})\]>]+)}i
  @ticket ~r{(\bticket[.=])[\w-]+}i
  @hidden "[hidden]"

  @doc "The text without what looks like a secret."
  @spec text(String.t()) :: String.t()
  def text(text) do
    text
    |> replace("://", @login, "\\1#{@hidden}@")
    |> replace("icket", @ticket, "\\1#{@hidden}")
    |> String.replace(@named, "\\1#{@hidden}")
  end

  defp replace(text, sign, pattern, with),
    do: if(String.contains?(text, sign), do: String.replace(text, pattern, with), else: text)
end
