defmodule MavCodec.Generated.Messages.Part5 do
  use MavCodec.Definition.Shard, messages: {5, 8}
end
